"""A virtual robot at a serial port with a simulated clock, fast and reproducible.

The clock advances when the host waits. Host code, firmware and twin are the real ones. The
operating system (port, priorities, watchdog process) and its delays are not simulated. Frames can
be lost and damaged.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from unittest import mock

import numpy as np

import motorprior as mp
from motorprior.actuator.physical import PhysicalMotors
from motorprior.hardware import robot_link, runs, session
from motorprior.hardware.protocol import Command, FrameReader, Telemetry, framed
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.virtual_robot import Firmware
from motorprior.simulation.simulated_robot import SimulatedRobot, draw_motors

DELAY = 1e-4  # transmission delay from host to robot [s]
_ROUNDING = 1e-6  # [ms]


class NoisyLine:
    """A line that loses frames with the probability ``drop``, and changes bytes with ``corrupt``.

    Each frame arrives after ``delay`` [s].
    """

    def __init__(self, drop: float, corrupt: float, delay: float, rng: np.random.Generator):
        self._drop = drop
        self._corrupt = corrupt
        self._delay = delay
        self._rng = rng
        self._waiting: list[tuple[float, bytes]] = []

    def put(self, frame: bytes, now: float) -> None:
        """Send a frame at ``now`` [s]."""
        rng = self._rng
        if not frame or rng.random() < self._drop:
            return
        if rng.random() < self._corrupt:
            position = int(rng.integers(len(frame)))
            damaged = bytearray(frame)
            damaged[position] ^= int(rng.integers(1, 256))
            frame = bytes(damaged)
        rng.random()  # keeps the random stream of published figures
        self._waiting.append((now + self._delay, frame))

    def take(self, now: float) -> bytes:
        """The bytes that arrive by ``now`` [s]."""
        arrived = [frame for at, frame in self._waiting if at <= now]
        self._waiting = [(at, frame) for at, frame in self._waiting if at > now]
        return b"".join(arrived)

    def due(self) -> float:
        """Arrival time of the next frame [s]."""
        return min((at for at, _ in self._waiting), default=math.inf)


class SimulatedPort(SerialLink):
    """A `SerialLink` to a virtual robot.

    Attributes:
        now: simulated time [s].
        body: simulated body of the robot.
        firmware: simulated firmware.
        path: distance walked [m], in straight segments of a second.

    Args:
        robot: description of the robot; its motors are sampled from its first fleet.
        number: seed of the motors.
        noise_seed: seed of the sensor noise and of the line.
        suspended: the robot hangs in the air.
        period: telemetry period [ms].
        drop: fraction of lost frames, in both directions.
        corrupt: fraction of damaged frames, in both directions.
        wear: function that wears the motors, see `closing_the_loop.with_wear`.
    """

    def __init__(  # pyright: ignore[reportMissingSuperCall]  # there is no device to open
        self,
        robot: mp.Robot,
        number: int,
        noise_seed: int = 0,
        *,
        suspended: bool = False,
        period: int = 10,
        drop: float = 0.0,
        corrupt: float = 0.0,
        wear: Callable[[PhysicalMotors, int], PhysicalMotors] | None = None,
    ):
        self.port = f"simulated robot {number}"
        self.now = 0.0
        self._joints = robot.num_joints

        motors = draw_motors(robot, mp.load_fleet(robot.fleets[0][0]), number)
        if wear is not None:
            motors = wear(motors, number)
        self.body = SimulatedRobot(robot, motors, suspended, noise_seed)
        self._period = period
        self.firmware = Firmware(robot, self.body, period)

        host_rng = np.random.default_rng([number, noise_seed, 0])
        robot_rng = np.random.default_rng([number, noise_seed, 1])
        self._to_host = NoisyLine(drop, corrupt, 0.0, host_rng)
        self._to_robot = NoisyLine(drop, corrupt, DELAY, robot_rng)
        self.reader = FrameReader(Telemetry, self._joints)
        self.unsent = bytearray()

        self.path = 0.0
        self._last_position = self.body.position()

    def fileno(self) -> int:
        """No file: the watchdog is replaced, too."""
        return -1

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        """See `SerialLink.wait`."""
        next_frame = 1e-3 * self._next_telemetry() + DELAY
        self.now = max(self.now, min(until, next_frame))
        self._advance()
        return [(self.now, message) for message in self.reader.feed(self._to_host.take(self.now))]

    def _next_telemetry(self) -> int:
        """Time of the next telemetry frame [ms]."""
        now = self.firmware.now
        return now + self._period - now % self._period

    def send(self, command: Command) -> float:
        """See `SerialLink.send`."""
        self._advance()
        self._to_robot.put(framed(command, self._joints), self.now)
        return self.now

    def discard_unsent(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Nothing to close."""

    def sleep(self, seconds: float) -> None:
        """`time.sleep` on this clock."""
        self.now += seconds

    def _advance(self) -> None:
        """Advance the robot to the current time.

        Each millisecond it first reads the frames that have arrived.
        """
        end = int(1e3 * (self.now - DELAY) + _ROUNDING)
        while (due := 1e3 * self._to_robot.due() - _ROUNDING) <= end:
            self._advance_to(math.ceil(due))
            self.firmware.receive(self._to_robot.take(1e-3 * (self.firmware.now + _ROUNDING)))
        self._advance_to(end)

    def _advance_to(self, milliseconds: int) -> None:
        while self.firmware.now < milliseconds:  # a telemetry period at a time
            end = min(milliseconds, self._next_telemetry())
            frame = self.firmware.advance(end - self.firmware.now)
            self._to_host.put(frame, self.now)
            if self.firmware.now % 1000 == 0:
                position = self.body.position()
                self.path += float(np.hypot(*(position - self._last_position)))
                self._last_position = position


@contextmanager
def on_its_clock(port: SimulatedPort) -> Iterator[None]:
    """Make the host use the clock of the port; `deploy` and `record` open it as any port."""
    with (
        mock.patch.object(runs, "SerialLink", lambda *_: port),
        mock.patch.object(time, "monotonic", lambda: port.now),
        mock.patch.object(time, "sleep", port.sleep),
        mock.patch.object(robot_link, "Watchdog", mock.MagicMock()),
        mock.patch.object(session, "real_time", nullcontext),
    ):
        yield
