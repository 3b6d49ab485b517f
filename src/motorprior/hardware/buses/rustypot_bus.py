"""Servo buses by rustypot (Apache-2.0), which speaks the protocols of Feetech and Dynamixel."""

import contextlib
import errno
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from motorprior.exceptions import ConfigError, RobotFault
from motorprior.hardware.buses.bus import Clock, NoAnswer, Readings, ServoInfo
from motorprior.hardware.buses.frames import DynamixelFormat, FeetechFormat
from motorprior.hardware.serial_link import no_port

# of an answer [s]; a USB converter may hold bytes back for 16 ms
_TIMEOUT = 0.03
_TRIES = 3  # of an instruction that must not get lost
_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class ServoFamily:
    """Servos with one control table, as rustypot names them, and the units of their registers.

    Units are those of the makers' control tables.
    """

    name: str
    controller: str  # class of rustypot
    format: FeetechFormat | DynamixelFormat
    baud_rates: tuple[int, ...]  # at which servos are searched, the usual one first [bit/s]
    counts: int  # per turn
    registers: Mapping[str, str]  # register of each quantity
    block: tuple[str, str]  # first and last register of the sensors' block
    full_torque: int  # value of torque_limit at full torque
    speed_unit: float  # [rad/s]
    profile_unit: float  # of the speed limit of the profile [rad/s]
    acceleration_unit: float  # [rad/s²]
    load_unit: str
    current_unit: str
    conditions: Mapping[int, str]  # by bit of the status
    ram_start: int  # registers at and above this address are not stored
    fast_sync_read: bool = False
    watchdog_unit: float = 0.0  # of the bus watchdog [s]; 0: there is none
    # register of the conditions; empty if the error field of every answer holds them
    status_register: str = ""
    # unit of measured speeds [rad/s] from registers, where they decide
    speed_unit_of: Callable[[Mapping[str, int]], float] | None = None

    def open(
        self,
        port: str,
        clock: Clock,
        ids: Sequence[int],
        baud_rate: int | None = None,
        timeout: float = _TIMEOUT,
    ) -> "RustypotBus":
        """The bus at the first of the usual baud rates, or the given one, at which servos answer.

        Raises RobotFault if the port cannot be opened, or none of the ``ids`` answers.
        """
        rates = self.baud_rates if baud_rate is None else (baud_rate,)
        for number, rate in enumerate(rates):
            try:
                bus = RustypotBus(self, port, rate, clock, timeout)
            except RobotFault:
                if number == 0:  # the port itself, and not a rate that it does not have
                    raise
                continue
            if bus.hears_one_of(ids):
                return bus
            bus.close()
        raise RobotFault(
            "silence",
            f"no answer from servo {', '.join(map(str, ids))} at "
            f"{', '.join(map(str, rates))} bit/s",
            remedy="check power, cable and ids, or give --baud-rate",
        )


def require_servos_extra() -> Any:
    """The module rustypot; raises ConfigError if it is not installed."""
    try:
        import rustypot
    except ImportError as error:
        raise ConfigError("rustypot is not installed", remedy="pip install rustypot") from error
    return rustypot


def _error_number(port: str) -> int | None:
    """The operating system's reason why a port cannot be opened; None if it can."""
    try:
        descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        return error.errno
    try:
        return None if os.isatty(descriptor) else errno.ENOTTY
    finally:
        os.close(descriptor)


class RustypotBus:
    """`ServoBus` of servos of one family.

    Args:
        family: the servos.
        port: name of the serial port.
        baud_rate: of the bus [bit/s].
        clock: the time of the bus.
        timeout: of an answer [s].

    Raises:
        RobotFault: the port cannot be opened.
    """

    def __init__(
        self,
        family: ServoFamily,
        port: str,
        baud_rate: int,
        clock: Clock,
        timeout: float = _TIMEOUT,
    ):
        module = require_servos_extra()
        controller = getattr(module, family.controller)
        try:
            self._controller = controller(port, baud_rate, timeout)
        except Exception as error:  # rustypot has no error of its own
            raise no_port(port, _error_number(port), str(error)) from error
        self.family = family
        self.port = port
        self.baud_rate = baud_rate
        self._clock = clock
        self._table = {register.name: register for register in controller.registers()}
        self._models = {number: name for name, number in controller.definition().models.items()}
        self.ids: tuple[int, ...] = ()
        self.counts = family.counts
        self.load_unit = family.load_unit
        self.current_unit = family.current_unit
        self._speed_unit = family.speed_unit
        if family.fast_sync_read:
            self._controller.set_fast_sync_read(True)

        first, last = (self._table[name] for name in family.block)
        self._block_start = first.addr
        self._block_size = last.addr + last.size - first.addr

    def hears_one_of(self, ids: Sequence[int]) -> bool:
        """Whether one of these servos answers."""
        for servo in ids:
            with contextlib.suppress(RuntimeError, OSError):
                self._controller.read_register(servo, "model_number", _TRIES)
                return True
        return False

    def scan(self, ids: Sequence[int]) -> list[ServoInfo]:
        """See `ServoBus`."""
        infos = []
        for servo in ids:
            try:
                number = self._controller.read_register(servo, "model_number", _TRIES)
            except (RuntimeError, OSError):
                continue
            infos.append(self._info(servo, number))
        return infos

    def _info(self, servo: int, number: int) -> ServoInfo:
        def read(quantity: str) -> int:
            name = self.family.registers.get(quantity)
            if name is None:
                return 0
            return self._controller.read_register(servo, name, _TRIES)

        family = self.family
        firmware = str(read("firmware"))
        if "firmware_minor" in family.registers:
            firmware += f".{read('firmware_minor')}"
        if family.speed_unit_of is not None:
            self._speed_unit = family.speed_unit_of({"phase": read("phase")})
        return ServoInfo(
            id=servo,
            model=self._models.get(number, f"model {number}"),
            firmware=firmware,
            voltage=0.1 * read("voltage"),
            temperature=float(read("temperature")),
            min_voltage=0.1 * read("min_voltage"),
            max_voltage=0.1 * read("max_voltage"),
            max_temperature=float(read("max_temperature")),
            gains=(read("p_gain"), read("i_gain"), read("d_gain")),
            profile_speed=family.profile_unit * abs(read("profile_speed")),
            profile_acceleration=family.acceleration_unit * read("acceleration"),
            dead_zone=_TURN / family.counts * read("dead_zone"),
            torque_limit=read("torque_limit") / family.full_torque,
            position_limits=(read("min_position"), read("max_position")),
            offset=read("offset"),
            return_delay=2e-6 * read("return_delay"),
            torque_on=bool(read("torque_enable")),
            conditions=self.condition_names(read("status")),
        )

    def read(self) -> Readings:
        """See `ServoBus`."""
        begin = self._clock.clock()
        try:
            data = self._controller.sync_read_raw_data_with_error(
                list(self.ids), self._block_start, self._block_size
            )
            conditions = [error for _, error in data]
            if self.family.status_register and any(conditions):
                conditions = self._controller.sync_read_register(
                    list(self.ids), self.family.status_register
                )
        except (RuntimeError, OSError) as error:
            self._clock.wait_until(begin + _TIMEOUT)
            raise NoAnswer(str(error)) from error
        end = self._clock.clock()
        blocks = [bytes(content) for content, _ in data]
        values = {
            quantity: np.array([self._value(quantity, block) for block in blocks], np.float64)
            for quantity in ("position", "speed", "load", "current", "voltage", "temperature")
        }
        return Readings(
            begin=begin,
            end=end,
            counts=values["position"],
            speed=self._speed_unit * values["speed"],
            load=values["load"],
            current=values["current"],
            voltage=0.1 * values["voltage"],
            temperature=values["temperature"],
            conditions=np.array(conditions),
        )

    def _value(self, quantity: str, block: bytes) -> int:
        name = self.family.registers.get(quantity)
        if name is None:
            return 0
        register = self._table[name]
        start = register.addr - self._block_start
        data = block[start : start + register.size]
        raw = int.from_bytes(data, "little")
        if register.encoding == "sign_magnitude":
            sign = 1 << register.sign_bit
            return -(raw & (sign - 1)) if raw & sign else raw
        if register.encoding == "twos_complement" and raw >= 1 << (8 * register.size - 1):
            return raw - (1 << (8 * register.size))
        return raw

    def write_goals(self, counts: np.ndarray) -> None:
        """See `ServoBus`."""
        self._write("goal_position", np.rint(counts).astype(int).tolist())

    def set_torque(self, on: bool) -> None:
        """See `ServoBus`."""
        for _ in range(_TRIES):  # a sync write has no answer
            self._write("torque_enable", [int(on)] * len(self.ids))

    def set_torque_limit(self, share: np.ndarray) -> None:
        """See `ServoBus`."""
        counts = np.rint(self.family.full_torque * share).astype(int).tolist()
        for _ in range(_TRIES):
            self._write("torque_limit", counts)

    def set_profile(self, speed: np.ndarray, acceleration: np.ndarray) -> None:
        """See `ServoBus`."""
        speeds = np.rint(speed / self.family.profile_unit).astype(int).tolist()
        accelerations = np.rint(acceleration / self.family.acceleration_unit).astype(int).tolist()
        for _ in range(_TRIES):
            self._write("profile_speed", speeds)
            self._write("acceleration", accelerations)

    def set_bus_watchdog(self, seconds: np.ndarray) -> None:
        """See `ServoBus`."""
        if not self.family.watchdog_unit:
            return
        units = np.rint(seconds / self.family.watchdog_unit).astype(int).tolist()
        off = [0] * len(self.ids)  # clears the state of a stopped servo
        for values in (off, units):
            for _ in range(_TRIES):
                self._write("bus_watchdog", values)

    def _write(self, quantity: str, values: list[int]) -> None:
        name = self.family.registers[quantity]
        register = self._table[name]
        assert register.addr >= self.family.ram_start, f"{name} is in the EEPROM"
        try:
            self._controller.sync_write_register(list(self.ids), name, values)
        except (RuntimeError, OSError) as error:
            raise NoAnswer(str(error)) from error
        self._clock.written()

    def release_frame(self, infos: Sequence[ServoInfo]) -> bytes:
        """See `ServoBus`."""
        family = self.family
        off = [0] * len(infos)
        frame = self._frame("torque_enable", off)
        if family.watchdog_unit:
            frame += self._frame("bus_watchdog", off)  # before goals, which it makes read-only
        limits = [round(family.full_torque * info.torque_limit) for info in infos]
        speeds = [round(info.profile_speed / family.profile_unit) for info in infos]
        steps = [round(info.profile_acceleration / family.acceleration_unit) for info in infos]
        frame += self._frame("torque_limit", limits)
        frame += self._frame("profile_speed", speeds)
        return frame + self._frame("acceleration", steps)

    def _frame(self, quantity: str, values: Sequence[int]) -> bytes:
        """The frame that writes non-negative values."""
        register = self._table[self.family.registers[quantity]]
        data = [value.to_bytes(register.size, "little") for value in values]
        return self.family.format.sync_write(self.ids, register.addr, data)

    def condition_names(self, bits: int) -> tuple[str, ...]:
        """See `ServoBus`."""
        names = [name for bit, name in self.family.conditions.items() if bits >> bit & 1]
        return tuple(names)

    def close(self) -> None:
        """See `ServoBus`."""
        with contextlib.suppress(Exception):
            self._controller.close()
