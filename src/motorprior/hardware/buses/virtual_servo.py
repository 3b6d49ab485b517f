"""Virtual servos: control tables and instructions of two makers' servos, byte by byte.

Written from the makers' pages: Feetech, memory table of the magnetic-encoder STS servos; ROBOTIS,
e-Manual of the XL330-M288-T. Registers that the pages name and no host here uses are plain memory.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.hardware.buses.frames import (
    DYNAMIXEL_FORMAT,
    FEETECH_FORMAT,
    DynamixelFormat,
    FeetechFormat,
)
from motorprior.robots.servos import ServoCommand, ServoState

COUNTS = 4096  # per turn of both makers' encoders
TURN = 2.0 * np.pi
_AMBIENT = 25.0  # [°C]
_HEATING = 40.0  # rise of the temperature at full torque [K]
_HEAT_TIME = 120.0  # [s]


class ServoMechanics(Protocol):
    """Motors and loads of virtual servos."""

    step: float  # [s]

    def set_command(self, command: ServoCommand) -> None:
        """Change what the firmware sets."""

    def advance(self, steps: int) -> None:
        """Simulate steps under the present command."""

    def state(self) -> ServoState:
        """The present state of the joints."""
        ...


@dataclass(frozen=True)
class ControlTable:
    """Memory of a servo: registers that the firmware uses, with their units."""

    format: FeetechFormat | DynamixelFormat
    registers: Mapping[str, tuple[int, int]]  # (address, bytes)
    defaults: Mapping[str, int]
    sign_bits: Mapping[str, int]  # of registers with a sign bit; the others: two's complement
    signed: frozenset[str]  # registers with a sign
    size: int  # [bytes]
    ram_start: int  # registers below are in the EEPROM
    full_torque: int  # value of torque_limit at full torque
    gain_unit: float  # proportional gain at which the motors' constants hold
    acceleration_unit: float  # [rad/s²]
    profile_unit: float  # of the speed limit of the profile [rad/s]
    speed_unit: float  # of the measured speed [rad/s]
    current_unit: float  # [A]
    full_current: float  # at full torque [A]
    nominal_voltage: float  # at which the motors' constants hold [V]
    conditions: Mapping[str, int]  # bit of each condition in the register "status"
    watchdog_unit: float = 0.0  # of the register "bus_watchdog" [s]; 0: there is none


FEETECH_STS = ControlTable(
    format=FEETECH_FORMAT,
    registers={
        "firmware": (0, 2), "model": (3, 2), "id": (5, 1), "return_delay": (7, 1),
        "min_position": (9, 2), "max_position": (11, 2), "max_temperature": (13, 1),
        "max_voltage": (14, 1), "min_voltage": (15, 1), "max_torque": (16, 2), "phase": (18, 1),
        "unloading": (19, 1), "p_gain": (21, 1), "d_gain": (22, 1), "i_gain": (23, 1),
        "dead_zone": (26, 1), "dead_zone_back": (27, 1), "offset": (31, 2), "mode": (33, 1),
        "torque_enable": (40, 1), "acceleration": (41, 1), "goal_position": (42, 2),
        "goal_time": (44, 2), "profile_speed": (46, 2), "torque_limit": (48, 2), "lock": (55, 1),
        "position": (56, 2), "speed": (58, 2), "load": (60, 2), "voltage": (62, 1),
        "temperature": (63, 1), "status": (65, 1), "moving": (66, 1), "current": (69, 2),
    },
    defaults={
        "firmware": 3 + (10 << 8), "model": 777, "max_position": COUNTS - 1,
        "max_temperature": 70, "max_voltage": 140, "min_voltage": 40, "max_torque": 1000,
        "phase": 4, "unloading": 44, "p_gain": 16, "d_gain": 32, "dead_zone": 1,
        "dead_zone_back": 1, "acceleration": 254, "torque_limit": 1000, "lock": 1,
    },
    sign_bits={
        "position": 15, "goal_position": 15, "speed": 15, "profile_speed": 15, "load": 10,
        "offset": 11,
    },
    signed=frozenset({"position", "goal_position", "speed", "profile_speed", "load", "offset"}),
    size=86,
    ram_start=40,
    full_torque=1000,
    gain_unit=16.0,
    acceleration_unit=100.0 * TURN / COUNTS,
    profile_unit=TURN / COUNTS,
    speed_unit=TURN / COUNTS,
    current_unit=0.0065,
    full_current=2.7,
    nominal_voltage=12.0,
    conditions={"voltage": 0, "encoder": 1, "temperature": 2, "current": 3, "overload": 5},
)  # fmt: skip
_REVOLUTION_PER_MINUTE = TURN / 60.0  # [rad/s]
DYNAMIXEL_XL330 = ControlTable(
    format=DYNAMIXEL_FORMAT,
    registers={
        "model": (0, 2), "firmware": (6, 1), "id": (7, 1), "return_delay": (9, 1),
        "drive_mode": (10, 1), "mode": (11, 1), "offset": (20, 4), "max_temperature": (31, 1),
        "max_voltage": (32, 2), "min_voltage": (34, 2), "max_torque": (36, 2),
        "max_position": (48, 4), "min_position": (52, 4), "unloading": (63, 1),
        "torque_enable": (64, 1), "status": (70, 1), "d_gain": (80, 2), "i_gain": (82, 2),
        "p_gain": (84, 2), "bus_watchdog": (98, 1), "torque_limit": (100, 2),
        "goal_current": (102, 2), "goal_speed": (104, 4), "acceleration": (108, 4),
        "profile_speed": (112, 4), "goal_position": (116, 4), "moving": (122, 1),
        "load": (124, 2), "current": (126, 2), "speed": (128, 4), "position": (132, 4),
        "voltage": (144, 2), "temperature": (146, 1),
    },
    defaults={
        "model": 1200, "firmware": 52, "return_delay": 250, "mode": 3, "max_temperature": 70,
        "max_voltage": 70, "min_voltage": 35, "max_torque": 885, "max_position": COUNTS - 1,
        "unloading": 53, "p_gain": 400, "torque_limit": 885,
    },
    sign_bits={},
    signed=frozenset(
        {"offset", "bus_watchdog", "goal_position", "load", "current", "speed", "position"}
    ),
    size=230,
    ram_start=64,
    full_torque=885,
    gain_unit=400.0,
    acceleration_unit=214.577 / 60.0 * _REVOLUTION_PER_MINUTE,
    profile_unit=0.229 * _REVOLUTION_PER_MINUTE,
    speed_unit=0.229 * _REVOLUTION_PER_MINUTE,
    current_unit=0.001,
    full_current=1.47,
    nominal_voltage=5.0,
    conditions={"voltage": 0, "temperature": 2, "encoder": 3, "current": 4, "overload": 5},
    watchdog_unit=0.02,
)  # fmt: skip
# registers that are read-only after the bus watchdog has stopped the servo
_GOALS = ("torque_limit", "goal_current", "goal_speed", "goal_position")
_TABLES = {"STS": FEETECH_STS, "XL330": DYNAMIXEL_XL330}


def table_of(model: str) -> ControlTable:
    """The control table of a servo by its name; raises ConfigError if there is none."""
    for beginning, table in _TABLES.items():
        if model.startswith(beginning):
            return table
    raise ConfigError(f"no virtual {model}", remedy="use STS3215 or XL330-M288", argument="motor")


class VirtualServo:
    """One servo: its memory, and the conditions that its firmware reports."""

    def __init__(self, table: ControlTable, servo: int, count: int):
        self.table = table
        self.memory = bytearray(table.size)
        self.eeprom_writes = 0
        self.temperature = _AMBIENT
        self.supply = table.nominal_voltage  # [V]
        self.stale = False  # position and speed no longer change
        self.jumps = False  # the encoder reads half a turn more
        # values written to the torque limit since the start
        self.history: dict[str, list[int]] = {"torque_limit": []}
        self.answers = True
        for name, value in table.defaults.items():
            self.set(name, value)
        self.set("id", servo)
        self.set("position", count)
        self.set("goal_position", count)

    def get(self, name: str) -> int:
        """Value of a register."""
        address, size = self.table.registers[name]
        raw = int.from_bytes(self.memory[address : address + size], "little")
        if name in self.table.sign_bits:
            sign = 1 << self.table.sign_bits[name]
            return -(raw & (sign - 1)) if raw & sign else raw
        if name in self.table.signed and raw >= 1 << (8 * size - 1):
            return raw - (1 << (8 * size))
        return raw

    def set(self, name: str, value: int) -> None:
        """Set a register."""
        address, size = self.table.registers[name]
        if name in self.table.sign_bits:
            sign = 1 << self.table.sign_bits[name]
            value = sign | min(-value, sign - 1) if value < 0 else value
        elif value < 0:
            value += 1 << (8 * size)
        self.memory[address : address + size] = value.to_bytes(size, "little")

    @property
    def id(self) -> int:
        """Its id on the bus."""
        return self.get("id")

    @property
    def status(self) -> int:
        """The error field of its answers."""
        conditions = self.get("status")
        if self.table.format is FEETECH_FORMAT:
            return conditions
        return 0x80 if conditions else 0

    def write(self, address: int, data: bytes) -> int:
        """Execute a write; returns the error number of Dynamixel Protocol 2.0, 0 for Feetech."""
        end = address + len(data)
        is_dynamixel = self.table.format is DYNAMIXEL_FORMAT
        if end > self.table.size or self._is_refused(address, data):
            return 4 * is_dynamixel  # data range error
        if address < self.table.ram_start:
            self.eeprom_writes += 1
            if is_dynamixel and self.get("torque_enable"):
                return 7  # access error
        self.memory[address:end] = data
        for name, values in self.history.items():
            if self.table.registers[name][0] == address:
                values.append(self.get(name))
        enable, _ = self.table.registers["torque_enable"]
        if address <= enable < end and self.get("status"):
            self.set("torque_enable", 0)  # a condition keeps the torque off
        return 0

    @property
    def is_stopped(self) -> bool:
        """Whether its bus watchdog has stopped it."""
        return self.table.watchdog_unit > 0.0 and self.get("bus_watchdog") < 0

    def _is_refused(self, address: int, data: bytes) -> bool:
        """Whether a stopped servo refuses a write: goals, and a bus watchdog other than 0."""
        if not self.is_stopped:
            return False
        registers = self.table.registers
        goals = [registers[name] for name in _GOALS]
        if any(address < start + size and start < address + len(data) for start, size in goals):
            return True
        return address == registers["bus_watchdog"][0] and data != b"\x00"

    def hear_nothing(self, seconds: float) -> None:
        """Stop where it is, if its bus watchdog allows no silence of ``seconds`` [s]."""
        if not self.table.watchdog_unit or not self.get("torque_enable"):
            return
        units = self.get("bus_watchdog")
        if 0 < units * self.table.watchdog_unit < seconds:
            self.set("bus_watchdog", -1)
            self.set("goal_position", self.get("position"))

    def condition(self, name: str, present: bool) -> None:
        """Report a condition, which switches the torque off."""
        bit = 1 << self.table.conditions[name]
        status = self.get("status")
        self.set("status", status | bit if present else status & ~bit)
        if present:
            self.set("torque_enable", 0)

    def sense(self, count: float, speed: float, duty: float, seconds: float) -> None:
        """Write the sensors' registers: angle [counts], speed [rad/s], duty [-].

        ``seconds`` passed since the last call.
        """
        table = self.table
        if self.jumps:
            count += COUNTS / 2
        if not self.stale:
            self.set("position", round(count))
            self.set("speed", round(speed / table.speed_unit))
        torque = duty * bool(self.get("torque_enable"))
        self.set("load", round(table.full_torque * torque))
        current = round(table.full_current * torque / table.current_unit)
        self.set("current", current if "current" in table.signed else abs(current))

        final = _AMBIENT + _HEATING * torque**2
        self.temperature += (final - self.temperature) * min(1.0, seconds / _HEAT_TIME)
        self.set("temperature", round(self.temperature))
        self.set("voltage", round(10.0 * self.supply))
        if self.temperature > self.get("max_temperature"):
            self.condition("temperature", True)
        is_in_range = self.get("min_voltage") <= 10.0 * self.supply <= self.get("max_voltage")
        if not is_in_range:
            self.condition("voltage", True)
