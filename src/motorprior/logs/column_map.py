"""Column maps: short TOML files that state what the columns of a third-party table mean (docs/your-motors.md).

An angle is sign·unit·value + zero, a velocity or torque sign·unit·value; a velocity has the sign of
the angle. An angle with ``wraps`` jumps by a turn in its column and is unwrapped. The table of a
channel overrides that of its joint, and that overrides [units].
"""

import math
import tomllib
from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

from motorprior.artifacts import read_toml
from motorprior.bounds import BOOLEAN, TABLE, TEXT, Field, is_number, number, one_of
from motorprior.exceptions import ArtifactError
from motorprior.logs.motor_log import (
    ENCODERS,
    GAIN_UNITS,
    OPERATING_CONDITIONS,
    PHYSICAL_GAINS,
    POSTURES,
)
from motorprior.schema import Schema

REMEDY = "see docs/your-motors.md"
TURN = 2.0 * math.pi
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SCALES: dict[str, dict[str, float]] = {
    # tick: TURN / ticks_per_turn
    "angle": {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "tick": math.nan},
    "velocity": {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0},
    "torque": {"N·m": 1.0, "mN·m": 1e-3, "kg·cm": 0.0980665},
    "voltage": {"V": 1.0, "dV": 0.1, "mV": 1e-3},
    "temperature": {"degC": 1.0},
}
QUANTITIES = {  # of the channels that may have a sign or a unit of their own
    "position_target": "angle", "joint_pos": "angle", "joint_vel": "velocity", "joint_torque": "torque",
    "external_torque": "torque", "supply_voltage": "voltage", "motor_temperature": "temperature",
}  # fmt: skip
SERIES = (*QUANTITIES, "load_inertia", "load_stiffness")  # channels with a column per joint
GAINS = ("kp", "kd")
# placeholders in column names
JOINT = "{joint}"
NAME = "{name}"

_UNITS = {name: one_of(*scales) for name, scales in SCALES.items()} | {
    "ticks_per_turn": number(above=1.0)
}
_CHANGES = {
    "scale": number(above=0.0),
    "sign": Field("1 or -1", lambda value: is_number(value, -1.0, 1.0) and abs(value) == 1),
    "zero": number(-TURN, TURN, unit="rad"),
    "wraps": BOOLEAN,
    "ticks_per_turn": _UNITS["ticks_per_turn"],
}  # and the unit of the channel's quantity
_NAME = Field(
    "a text of 1 to 200 letters", lambda value: TEXT.accepts(value) and 0 < len(value) <= 200
)
_CONDITION = Field(
    "the name of a column, or a number", lambda value: _NAME.accepts(value) or is_number(value)
)
_MAP = Schema(
    {
        **dict.fromkeys(("motor", "robot", "time", "segment", *SERIES), _NAME),
        **dict.fromkeys(OPERATING_CONDITIONS, _CONDITION),
        "rate": number(1e-3, 1e6, unit="Hz"),
        "encoder": one_of(*ENCODERS),
        "posture": one_of(*POSTURES),
        **dict.fromkeys(("units", "firmware"), TABLE),
        "joints": Field(
            "a table with a table per joint", lambda value: TABLE.accepts(value) and len(value) > 0
        ),
    },
    REMEDY,
    optional=frozenset(
        {"robot", "time", "rate", "segment", "posture", "encoder", "units", "firmware", *SERIES[2:]}
    ),
)
_PLAIN = ("motor", "robot", "encoder", "time", "rate", "segment", "posture")
_MAPS = files("motorprior.logs").joinpath("maps")
_UNIT_TABLE = {**_UNITS, "wraps": BOOLEAN, "time": one_of(*TIMES), "gain": one_of(*GAIN_UNITS)}
_JOINT = {
    "name": _NAME, **_CHANGES, "angle": _UNITS["angle"], **dict.fromkeys(QUANTITIES, TABLE),
    **dict.fromkeys(GAINS, number(0.0)),
}  # fmt: skip


@dataclass(frozen=True)
class Conversion:
    """A value in SI units is factor·value of the column + offset."""

    factor: float = 1.0
    offset: float = 0.0
    wraps: bool = False  # the column jumps by a turn where the angle does not


@dataclass(frozen=True)
class MappedJoint:
    """A joint: its name in the columns, the robot's name for it, gains, and conversions of channels not in SI units."""

    column: str
    name: str
    kp: float | None = None
    kd: float | None = None
    conversions: Mapping[str, Conversion] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """The meaning of the columns of a table; names, encoder, posture, gain_unit and firmware as in `MotorLog`."""

    source: str  # file or name of the map
    # channel -> name of its columns with JOINT or NAME; a condition may be one for all joints
    series: dict[str, str]
    joints: tuple[MappedJoint, ...]
    motor: str = ""
    robot: str = ""
    encoder: str = ""
    time: str | None = None  # its column, or None with rate
    time_scale: float = 1.0  # seconds per unit of that column
    rate: float | None = None  # row rate [Hz]
    segment: str | None = None  # column with the index of the recording
    posture: str | None = None
    base_orientation: tuple[str, ...] = ()  # columns of roll and pitch [rad]
    operating_conditions: Mapping[str, float] = field(
        default_factory=dict
    )  # values for all rows and joints
    gain_unit: str = PHYSICAL_GAINS
    firmware: Mapping[str, float] = field(default_factory=dict)

    def columns_of(self, channel: str, joints: Iterable[MappedJoint]) -> list[str]:
        """Column names of a channel, one per joint."""
        return [
            self.series[channel].replace(JOINT, joint.column).replace(NAME, joint.name)
            for joint in joints
        ]


def shipped_maps() -> tuple[str, ...]:
    """Names of the maps in the package."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _MAPS.iterdir()))


def load_column_map(columns: ColumnMap | str | Path) -> ColumnMap:
    """A map itself, a shipped one by name, or a .toml file by path.

    Raises ArtifactError for no such map or file, no TOML, or an unknown or bad entry, with its key
    and value.
    """
    if isinstance(columns, ColumnMap):
        return columns
    if Path(columns).suffix == ".toml":
        return _from_table(read_toml(Path(columns), REMEDY), str(columns))
    if str(columns) not in shipped_maps():
        remedy = f"use one of {', '.join(shipped_maps())}, or the path of a .toml file"
        raise ArtifactError(f"no column map {str(columns)!r}", remedy=remedy)
    return _from_table(tomllib.loads((_MAPS / f"{columns}.toml").read_text("utf-8")), str(columns))


def _from_table(table: dict[str, Any], where: str) -> ColumnMap:
    _MAP.check(table, where)
    units = table.get("units", {})
    _check(units, _UNIT_TABLE, f"{where}[units]")
    if ("time" in table) == ("rate" in table):
        problem = (
            "both time and rate" if "time" in table else "neither time, a column, nor rate [Hz]"
        )
        raise ArtifactError(problem, where=where, remedy="give one of the two")
    series = {name: table[name] for name in SERIES if isinstance(table.get(name), str)}
    for name, column in series.items():
        one_for_all = name in OPERATING_CONDITIONS or len(table["joints"]) == 1
        if not one_for_all and JOINT not in column and NAME not in column:
            remedy = f"put {JOINT} in place of the joint's name; pivot a table with a row per joint and time; {REMEDY}"
            raise ArtifactError(
                f"{name} = {column[:40]!r} lacks {JOINT} or {NAME}", where=where, remedy=remedy
            )
    scales = {name: _scale(QUANTITIES[name], (units,), where) for name in OPERATING_CONDITIONS}
    return ColumnMap(
        source=where,
        time_scale=TIMES[units.get("time", "s")],
        series=series,
        joints=_joints(table["joints"], units, where),
        gain_unit=units.get("gain", PHYSICAL_GAINS),
        firmware=table.get("firmware", {}),
        operating_conditions={
            name: table[name] * scales[name]
            for name in OPERATING_CONDITIONS
            if is_number(table.get(name))
        },
        **{name: table[name] for name in _PLAIN if name in table},
    )


def _check(table: Any, fields: Mapping[str, Field], where: str) -> None:
    Schema(fields, REMEDY, optional=frozenset(fields)).check(table, where)


def _joints(table: dict[str, Any], units: dict[str, Any], where: str) -> tuple[MappedJoint, ...]:
    found = []
    for column, joint in table.items():
        place = f"{where}[joints.{column}]"
        _check(joint, _JOINT, place)
        known = {name: _conversion(name, joint, units, place) for name in QUANTITIES}
        found.append(
            MappedJoint(column, joint.get("name", column), joint.get("kp"), joint.get("kd"), known)
        )
    names = [joint.name for joint in found]
    if double := {name for name in names if names.count(name) > 1}:
        raise ArtifactError(
            f"two joints are named {min(double)!r}", where=where, remedy="name each once"
        )
    for name in GAINS:
        lacking = [joint.column for joint in found if getattr(joint, name) is None]
        if 0 < len(lacking) < len(found):
            problem = f"joint {lacking[0]!r} lacks {name}, others have it"
            raise ArtifactError(problem, where=where, remedy="give all or none")
    return tuple(found)


def _conversion(
    channel: str, joint: dict[str, Any], units: dict[str, Any], place: str
) -> Conversion:
    quantity = QUANTITIES[channel]
    own = joint.get(channel, {})
    _check(own, _CHANGES | {quantity: _UNITS[quantity]}, f"{place}.{channel}")
    tables = (own, joint, units) if quantity == "angle" else (own, units)
    sign = 1 if channel in OPERATING_CONDITIONS else joint.get("sign", 1)
    if channel == "joint_vel":
        sign = joint.get("joint_pos", {}).get("sign", sign)
    changes = ChainMap(*tables)
    return Conversion(
        float(own.get("sign", sign) * _scale(quantity, tables, place)),
        float(changes.get("zero", 0.0)),
        quantity == "angle" and changes.get("wraps", False),
    )


def _scale(quantity: str, tables: tuple[dict[str, Any], ...], where: str) -> float:
    """SI units per unit of the column, from the first table that gives one."""
    for table in tables:
        unit = table.get(
            quantity, "tick" if quantity == "angle" and "ticks_per_turn" in table else None
        )
        if "scale" in table:
            return float(table["scale"])
        if unit == "tick":
            if ticks := ChainMap(*tables).get("ticks_per_turn"):
                return TURN / ticks
            raise ArtifactError("angle = 'tick' without ticks_per_turn", where=where, remedy=REMEDY)
        if unit is not None:
            return SCALES[quantity][unit]
    return 1.0
