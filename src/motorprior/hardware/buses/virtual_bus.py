"""A virtual servo bus behind a pseudo-terminal, with faults on demand.

It speaks the protocol byte by byte and knows its servos' baud rate and return delays, so that its
clock tells how long each exchange takes on the wire. The clock is simulated: it advances with the
bytes on the wire and with the host's waiting, as fast as this computer can, or it follows real
time.
"""

import contextlib
import os
import pty
import select
import threading
import time
import tty

import numpy as np

from motorprior.hardware.buses.frames import (
    BROADCAST,
    DYNAMIXEL_FORMAT,
    FAST_SYNC_READ,
    PING,
    READ,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    Instruction,
)
from motorprior.hardware.buses.virtual_servo import (
    COUNTS,
    TURN,
    ControlTable,
    ServoMechanics,
    VirtualServo,
)
from motorprior.robots.servos import ServoChain, ServoCommand

_BITS_PER_BYTE = 10  # 8N1
_MAX_CATCH_UP = 0.05  # maximum simulated time per slice, so that other threads get the bus [s]
SENSE_PERIOD = 0.001  # period at which the firmware reads its sensors [s]
# delay of a USB converter and the host's driver per exchange [s]
_HOST_DELAY = 0.0005
_MAX_TRANSFER = 1.0  # time of a pseudo-terminal to pass bytes on [s], on a very busy computer


class VirtualBus:
    """A bus with servos of one kind.

    Attributes:
        port: name of the pseudo-terminal.
        servos: the servos, in the order of the chain.
        now: time of the bus [s].

    Args:
        table: control table of the servos.
        chain: ids, signs and zeros.
        mechanics: motors and loads.
        baud_rate: bytes on the wire take 10 bits each [bit/s].
        in_real_time: follow the monotonic clock; otherwise the time is simulated.
        seed: seed of lost and damaged frames.
    """

    def __init__(
        self,
        table: ControlTable,
        chain: ServoChain,
        mechanics: ServoMechanics,
        baud_rate: int = 1_000_000,
        in_real_time: bool = False,
        seed: int = 0,
    ):
        self._table = table
        self._mechanics = mechanics
        self._byte_time = _BITS_PER_BYTE / baud_rate
        self._in_real_time = in_real_time
        self._rng = np.random.default_rng(seed)
        self._signs = np.array(chain.signs, dtype=np.float64)
        self._zeros = np.array(chain.zeros, dtype=np.float64)
        state = mechanics.state()
        counts = self._counts(state.pos)
        self.servos = [
            VirtualServo(table, servo, round(count))
            for servo, count in zip(chain.ids, counts, strict=True)
        ]
        self.now = 0.0
        self._started = time.monotonic()
        self._sensed = 0.0  # time of the last reading of the sensors [s]
        self._heard = 0.0  # time of the last instruction [s]
        self._steps = 0  # physics steps since the start
        self.blocked = np.zeros(len(self.servos), bool)
        # shares of lost and of damaged answers [-]
        self.lost = 0.0
        self.damaged = 0.0
        # numbers of instructions without answer, received and sent
        self._unanswered = 0
        self._unanswered_sent = 0

        self._lock = threading.RLock()
        self._buffer = bytearray()
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._update_command()
        self._thread.start()

    def __enter__(self) -> "VirtualBus":
        return self

    def __exit__(self, *_: object) -> None:
        self.unplug()

    def unplug(self) -> None:
        """Remove the port, as if the cable was pulled."""
        self._ended.set()
        self._thread.join(timeout=5.0)
        with self._lock:
            for descriptor in (self._slave, self._master):
                with contextlib.suppress(OSError):
                    os.close(descriptor)

    def wait_until(self, end: float) -> None:
        """Let time pass until ``end`` [s] on the clock of the bus."""
        if self._in_real_time:
            time.sleep(max(0.0, end - (time.monotonic() - self._started)))
            return
        while self.now < end:
            with self._lock:
                self._advance(min(end, self.now + _MAX_CATCH_UP))

    def written(self) -> None:
        """Wait until the servos have received an instruction without answer.

        A pseudo-terminal takes some real time to pass bytes on, which must not count.
        """
        if self._in_real_time:
            return
        self._unanswered_sent += 1
        give_up = time.monotonic() + _MAX_TRANSFER
        while self._unanswered < self._unanswered_sent and time.monotonic() < give_up:
            time.sleep(2e-5)
        self._unanswered_sent = self._unanswered

    def clock(self) -> float:
        """Time of the bus [s]."""
        return time.monotonic() - self._started if self._in_real_time else self.now

    def set_supply(self, volts: float) -> None:
        """Change the supply voltage of all servos [V]."""
        with self._lock:
            for servo in self.servos:
                servo.supply = volts
            self._update_command()

    def block(self, index: int) -> None:
        """An obstacle holds a joint."""
        with self._lock:
            self.blocked[index] = True
            self._update_command()

    def joint_pos(self) -> np.ndarray:
        """(n,) true joint angles [rad]."""
        with self._lock:
            return self._mechanics.state().pos

    def _serve(self) -> None:
        """Answer until the cable is pulled."""
        while not self._ended.is_set():
            ready, _, _ = select.select([self._master], [], [], 0.005)
            with self._lock:
                if self._in_real_time:
                    now = time.monotonic() - self._started
                    if ready:  # a busy computer makes no silence
                        self._heard = now
                    self._advance(now)
                if ready:
                    self._receive()

    def _receive(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except OSError:
            return
        self._buffer += data
        self._pass(len(data) * self._byte_time)
        for instruction in self._table.format.instructions(self._buffer):
            self._pass(_HOST_DELAY)
            self._heard = self.now
            answers = self._execute(instruction)
            for answer in answers:
                self._send(answer)
            if not answers:
                self._unanswered += 1

    def _pass(self, seconds: float) -> None:
        if not self._in_real_time:
            self._advance(self.now + seconds)

    def _send(self, answer: bytes) -> None:
        if self._rng.random() < self.lost:
            return
        if self._rng.random() < self.damaged:
            damaged = bytearray(answer)
            damaged[self._rng.integers(len(damaged))] ^= int(self._rng.integers(1, 256))
            answer = bytes(damaged)
        with contextlib.suppress(OSError):
            os.write(self._master, answer)

    def _execute(self, instruction: Instruction) -> list[bytes]:
        """Execute an instruction; returns the answers, each read when its servo sends it."""
        addressed = self._addressed(instruction.servo)
        parameters = instruction.parameters
        if instruction.code == PING:
            return [self._answer(servo, self._identity(servo)) for servo in addressed]
        if instruction.code == READ:
            address, size = self._span(parameters)
            return [self._answer(servo, self._read(servo, address, size)) for servo in addressed]
        if instruction.code in (SYNC_READ, FAST_SYNC_READ):
            return self._sync_read(instruction)
        if instruction.code == SYNC_WRITE:
            self._sync_write(parameters)
            return []
        if instruction.code == WRITE:
            width = self._address_width
            address = int.from_bytes(parameters[:width], "little")
            errors = [servo.write(address, parameters[width:]) for servo in addressed]
            self._update_command()
            if instruction.servo == BROADCAST:
                return []
            pairs = zip(addressed, errors, strict=True)
            return [self._answer(servo, b"", error) for servo, error in pairs]
        return []

    @property
    def _address_width(self) -> int:
        """Bytes of an address, and of a number of bytes, in a frame."""
        return 2 if self._table.format is DYNAMIXEL_FORMAT else 1

    def _span(self, parameters: bytes) -> tuple[int, int]:
        width = self._address_width
        address = int.from_bytes(parameters[:width], "little")
        return address, int.from_bytes(parameters[width : 2 * width], "little")

    def _addressed(self, servo_id: int) -> list[VirtualServo]:
        servos = [servo for servo in self.servos if servo.answers]
        if servo_id == BROADCAST:
            return servos
        return [servo for servo in servos if servo.id == servo_id]

    def _identity(self, servo: VirtualServo) -> bytes:
        """Parameters of the answer to a ping."""
        if self._table.format is not DYNAMIXEL_FORMAT:
            return b""
        return servo.get("model").to_bytes(2, "little") + bytes([servo.get("firmware")])

    def _answer(self, servo: VirtualServo, data: bytes, error: int = 0) -> bytes:
        frame = self._table.format.status(servo.id, servo.status | error, data)
        self._pass(2e-6 * servo.get("return_delay") + len(frame) * self._byte_time)
        return frame

    def _read(self, servo: VirtualServo, address: int, size: int) -> bytes:
        return bytes(servo.memory[address : address + size])

    def _sync_read(self, instruction: Instruction) -> list[bytes]:
        address, size = self._span(instruction.parameters)
        ids = instruction.parameters[2 * self._address_width :]
        if instruction.code == FAST_SYNC_READ:
            servos = [self._addressed(servo) for servo in ids]
            if not all(servos):  # a servo waits for its turn
                return []
            answers = [
                (servo.id, servo.status, self._read(servo, address, size)) for (servo,) in servos
            ]
            frame = DYNAMIXEL_FORMAT.fast_status(answers)
            self._pass(len(frame) * self._byte_time)
            return [frame]

        frames = []
        for servo_id in ids:
            for servo in self._addressed(servo_id):
                frames.append(self._answer(servo, self._read(servo, address, size)))
        return frames

    def _sync_write(self, parameters: bytes) -> None:
        address, size = self._span(parameters)
        data = parameters[2 * self._address_width :]
        for start in range(0, len(data), size + 1):
            for servo in self._addressed(data[start]):
                servo.write(address, data[start + 1 : start + 1 + size])
        self._update_command()

    def _advance(self, end: float) -> None:
        """Simulate until ``end`` [s]; sensors are read every millisecond."""
        while self.now < end:
            self.now = min(end, self._sensed + SENSE_PERIOD)
            steps = round(self.now / self._mechanics.step) - self._steps
            if steps > 0:
                self._mechanics.advance(steps)
                self._steps += steps
            if self.now >= self._sensed + SENSE_PERIOD - 1e-9:
                self._sense()

    def _sense(self) -> None:
        seconds = self.now - self._sensed
        self._sensed = self.now
        state = self._mechanics.state()
        counts = self._counts(state.pos)
        speeds = self._signs * state.vel
        duties = self._signs * state.duty
        before = [(servo.get("torque_enable"), servo.is_stopped) for servo in self.servos]
        for index, servo in enumerate(self.servos):
            servo.sense(counts[index], speeds[index], duties[index], seconds)
            servo.hear_nothing(self.now - self._heard)
        if before != [(servo.get("torque_enable"), servo.is_stopped) for servo in self.servos]:
            self._update_command()

    def _counts(self, joint_pos: np.ndarray) -> np.ndarray:
        """(n,) encoder counts of (n,) joint angles [rad]."""
        return self._zeros + self._signs * joint_pos * COUNTS / TURN

    def _update_command(self) -> None:
        """Give the registers to the motors."""
        table = self._table

        def registers(name: str) -> np.ndarray:
            return np.array([servo.get(name) for servo in self.servos], dtype=np.float64)

        goals = registers("goal_position")
        supplies = np.array([servo.supply for servo in self.servos])
        # the profile of a servo that stops by itself is 0
        profiled = np.array([not servo.is_stopped for servo in self.servos])
        command = ServoCommand(
            target=self._signs * (goals - self._zeros) * TURN / COUNTS,
            enabled=registers("torque_enable") > 0,
            gain=registers("p_gain") / table.gain_unit,
            torque_share=registers("torque_limit") / table.full_torque,
            speed=profiled * table.profile_unit * registers("profile_speed"),
            acceleration=profiled * table.acceleration_unit * registers("acceleration"),
            supply=supplies / table.nominal_voltage,
            blocked=self.blocked.copy(),
        )
        self._mechanics.set_command(command)
