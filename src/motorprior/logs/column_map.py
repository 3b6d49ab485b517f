"""Column maps: short TOML files that state what the columns of a third-party table mean.

docs/your-motors.md describes them. An angle is sign·unit·(value - center) + zero; a velocity or
torque is sign·unit·value, where a velocity has the sign of the angle. A column of angles with
``wraps`` jumps by a turn where the angle does not; it is unwrapped. The table of a channel
overrides the table of its joint, and the table of the joint overrides [units].
"""

import math
import tomllib
from collections import ChainMap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motorprior.artifacts import read_toml
from motorprior.bounds import BOOLEAN, TABLE, TEXT, Field, is_number, number, one_of
from motorprior.exceptions import ArtifactError
from motorprior.logs.motor_log import (
    ENCODERS,
    OPERATING_CONDITIONS,
    PHYSICAL_GAINS,
    POSTURES,
)
from motorprior.schema import Schema

if TYPE_CHECKING:
    from motorprior.robots.robot import Robot

REMEDY = "see docs/your-motors.md"
TURN = 2.0 * math.pi
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
SCALES: dict[str, dict[str, float]] = {
    # tick: TURN / ticks_per_turn
    "angle": {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "tick": math.nan},
    "velocity": {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0, "turn/s": TURN},
    "torque": {"N·m": 1.0, "mN·m": 1e-3, "kg·cm": 0.0980665},
    "voltage": {"V": 1.0, "dV": 0.1, "mV": 1e-3},
    "temperature": {"degC": 1.0},
}
# channel that may have its own sign or unit -> its quantity
QUANTITIES = {
    "position_target": "angle",
    "velocity_target": "velocity",
    "torque_feedforward": "torque",
    "joint_pos": "angle",
    "joint_vel": "velocity",
    "joint_torque": "torque",
    "external_torque": "torque",
    "supply_voltage": "voltage",
    "motor_temperature": "temperature",
}
GAINS = ("kp", "kd")
# channels with a column per joint; kp and kd are the gains in force in each row
SERIES = (*QUANTITIES, "load_inertia", "load_stiffness", *GAINS)
COMMANDS = ("position_target", "velocity_target", "torque_feedforward")
BASE_ANGLES = ("base_roll", "base_pitch")
MAX_NUMBER_BITS = 64
# a velocity has the sign of its angle
_ANGLE_OF_VELOCITY = {"joint_vel": "joint_pos", "velocity_target": "position_target"}
# placeholders in column names
JOINT = "{joint}"
NAME = "{name}"

_UNITS = {name: one_of(*scales) for name, scales in SCALES.items()} | {
    "ticks_per_turn": number(above=1.0),
    "center": number(-1e6, 1e6),
}
# entries that convert the values of a channel, besides the unit of its quantity
_CHANGES = {
    "scale": number(above=0.0),
    "sign": Field("1 or -1", lambda value: is_number(value, -1.0, 1.0) and abs(value) == 1),
    "zero": number(-TURN, TURN, unit="rad"),
    "wraps": BOOLEAN,
    "ticks_per_turn": _UNITS["ticks_per_turn"],
    "center": _UNITS["center"],
}


def _is_name(value: Any) -> bool:
    return TEXT.accepts(value) and 0 < len(value) <= 200


def _is_name_or_number(value: Any) -> bool:
    return _is_name(value) or is_number(value)


def _is_table_with_entries(value: Any) -> bool:
    return TABLE.accepts(value) and len(value) > 0


def _is_name_or_pair(value: Any) -> bool:
    is_pair = isinstance(value, list) and len(value) == 2 and all(map(_is_name, value))
    return is_pair or _is_name(value)


def _is_quaternion(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 4 and all(map(_is_name, value))


_NAME = Field("a text of 1 to 200 letters", _is_name)
_NAME_OR_NUMBER = Field("the name of a column, or a number", _is_name_or_number)
_TIME = Field(
    "the name of a column, or those of seconds and nanoseconds in a list", _is_name_or_pair
)
_QUATERNION = Field("a list of the columns of w, x, y and z", _is_quaternion)
QUATERNION_ORDERS = ("wxyz", "xyzw")
_MAP = Schema(
    {
        **dict.fromkeys(("motor", "robot", "segment", *SERIES), _NAME),
        **dict.fromkeys((*OPERATING_CONDITIONS, *BASE_ANGLES, *GAINS), _NAME_OR_NUMBER),
        "base_quaternion": _QUATERNION,
        "quaternion_order": one_of(*QUATERNION_ORDERS),
        "time": _TIME,
        "time_bits": number(8, MAX_NUMBER_BITS),
        "rate": number(1e-3, 1e6, unit="Hz"),
        "encoder": one_of(*ENCODERS),
        "posture": one_of(*POSTURES),
        **dict.fromkeys(("units", "firmware"), TABLE),
        "joints": Field("a table with a table per joint", _is_table_with_entries),
    },
    REMEDY,
    optional=frozenset(
        {
            *("robot", "time", "time_bits", "rate", "segment", "posture", "encoder"),
            *("units", "firmware", "joints", "base_quaternion", "quaternion_order"),
            *(*BASE_ANGLES, *SERIES),
        }
    )
    - {"joint_pos"},
)
# entries that `ColumnMap` copies without a conversion
_COPIED = ("motor", "robot", "encoder", "time_bits", "rate", "segment", "posture")
_MAPS = files("motorprior.logs").joinpath("maps")
# N·m/rad per unit of kp, and N·m·s/rad per unit of kd; gains in firmware units stay
GAIN_SCALES = {PHYSICAL_GAINS: 1.0, "N·m/turn": 1.0 / TURN, "firmware": 1.0}
_UNIT_TABLE = {
    **_UNITS,
    "base": one_of("rad", "deg"),
    "wraps": BOOLEAN,
    "time": one_of(*TIMES),
    "gain": one_of(*GAIN_SCALES),
}
_JOINT = {
    "name": _NAME,
    **_CHANGES,
    "angle": _UNITS["angle"],
    **dict.fromkeys(QUANTITIES, TABLE),
    **dict.fromkeys(GAINS, number(0.0)),
}


@dataclass(frozen=True)
class Conversion:
    """Conversion of a column to SI units: factor · (value in the column) + offset."""

    factor: float = 1.0
    offset: float = 0.0
    wraps: bool = False  # the column jumps by a turn where the angle does not


@dataclass(frozen=True)
class MappedJoint:
    """A joint: its name in the columns, its name in the robot, gains, and conversions to SI units.

    Channels without a conversion are in SI units.
    """

    column: str
    name: str
    kp: float | None = None
    kd: float | None = None
    conversions: Mapping[str, Conversion] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """The meaning of the columns of a table.

    Names, encoder, posture, gain_unit and firmware are as in `MotorLog`.
    """

    source: str  # file or name of the map
    # channel, kp or kd -> name of its columns with the placeholder JOINT or NAME; a column of an
    # operating condition or gain without placeholder is for all joints
    series: dict[str, str]
    joints: tuple[MappedJoint, ...]  # none: those of the robot, each as ``every_joint``
    every_joint: MappedJoint | None = None
    motor: str = ""
    robot: str = ""
    encoder: str = ""
    time: str | None = None  # column of the time; None if the rate is given
    time_scale: float = 1.0  # seconds per unit of the column ``time``
    subseconds: str | None = None  # column that adds to the column ``time`` [s]
    subsecond_scale: float = 1e-9  # seconds per unit of the column ``subseconds``
    time_bits: float | None = None  # the column ``time`` restarts at 0 after 2^time_bits - 1
    rate: float | None = None  # row rate [Hz]
    segment: str | None = None  # column with the index of the recording
    posture: str | None = None
    # columns of roll and pitch, or of the quaternion w, x, y, z of the base in the world
    base_orientation: tuple[str, ...] = ()
    base_angle_scale: float = 1.0  # rad per unit of the columns of roll and pitch
    base_angles: tuple[float, float] | None = None  # constant roll and pitch [rad]
    # constant operating conditions, the same for all rows and joints
    operating_conditions: Mapping[str, float] = field(default_factory=dict)
    gain_unit: str = PHYSICAL_GAINS
    gain_scale: float = 1.0  # ``gain_unit`` per unit of kp, kd and their columns
    firmware: Mapping[str, float] = field(default_factory=dict)

    def columns_of(self, channel: str, joints: Iterable[MappedJoint]) -> list[str]:
        """Column names of a channel, one per joint."""
        return [
            self.series[channel].replace(JOINT, joint.column).replace(NAME, joint.name)
            for joint in joints
        ]

    def of_robot(self, robot: "Robot | None") -> "ColumnMap":
        """The map with the robot's joints, if it names none of its own.

        Raises ArtifactError for a map without joints if there is no robot, or if its columns are
        the same for all joints.
        """
        if self.every_joint is None:
            return self
        remedy = "add a table per joint, such as [joints.hip]"
        if robot is None:
            raise ArtifactError(
                "no joints",
                where=self.source,
                remedy=f"give robot, or {remedy}",
                argument="robot",
            )

        names = robot.joint_names
        _require_placeholders(self.series, len(names), self.source)
        joints = tuple(replace(self.every_joint, column=name, name=name) for name in names)
        return replace(self, joints=joints, every_joint=None)


def shipped_maps() -> tuple[str, ...]:
    """Names of the maps in the package."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _MAPS.iterdir()))


def load_column_map(columns: ColumnMap | str | Path) -> ColumnMap:
    """A column map: ``columns`` itself, a shipped map by name, or a .toml file by path.

    Raises:
        ArtifactError: there is no such map or file, the file is no TOML, or an entry is unknown or
            invalid; the message names its key and value.
    """
    if isinstance(columns, ColumnMap):
        return columns
    if Path(columns).suffix == ".toml":
        return _from_table(read_toml(Path(columns), REMEDY), str(columns))
    if str(columns) not in shipped_maps():
        remedy = f"use one of {', '.join(shipped_maps())}, or the path of a .toml file"
        raise ArtifactError(f"no column map {str(columns)!r}", remedy=remedy)
    text = (_MAPS / f"{columns}.toml").read_text("utf-8")
    return _from_table(tomllib.loads(text), str(columns))


def _from_table(table: dict[str, Any], where: str) -> ColumnMap:
    _MAP.check(table, where)
    units = table.get("units", {})
    _check(units, _UNIT_TABLE, f"{where}[units]")
    _require_time_or_rate(table, where)

    _require_command(table, where)

    gain = units.get("gain", PHYSICAL_GAINS)
    constants = {name: table[name] for name in OPERATING_CONDITIONS if is_number(table.get(name))}
    scales = {name: _scale(QUANTITIES[name], (units,), where) for name in OPERATING_CONDITIONS}
    joints = _joints(table, units, GAIN_SCALES[gain], where)
    _require_velocity_unit(table, units, where)
    return ColumnMap(
        source=where,
        **_time_columns(table, units, where),
        **_base(table, units, where),
        series=_series(table, where),
        **joints,
        gain_unit="firmware" if gain == "firmware" else PHYSICAL_GAINS,
        gain_scale=GAIN_SCALES[gain],
        firmware=table.get("firmware", {}),
        operating_conditions={name: value * scales[name] for name, value in constants.items()},
        **{name: table[name] for name in _COPIED if name in table},
    )


def _require_time_or_rate(table: dict[str, Any], where: str) -> None:
    remedy = "give one of the two"
    if "time" in table and "rate" in table:
        raise ArtifactError("both time and rate", where=where, remedy=remedy)
    if "time" not in table and "rate" not in table:
        raise ArtifactError("neither time, a column, nor rate [Hz]", where=where, remedy=remedy)


def _require_command(table: dict[str, Any], where: str) -> None:
    if not any(name in table for name in COMMANDS):
        raise ArtifactError(
            "no command",
            where=where,
            remedy=f"give the columns of every command that was sent: {', '.join(COMMANDS)}",
        )


def _require_velocity_unit(table: dict[str, Any], units: dict[str, Any], where: str) -> None:
    """Raise ArtifactError for velocities without a unit of a joint with angles in degrees or turns.

    Such velocities are hardly in rad/s.
    """
    joints = table.get("joints", {JOINT: {}})
    velocities = [name for name in _ANGLE_OF_VELOCITY if name in table]
    for (joint, entries), velocity in product(joints.items(), velocities):
        if _unit("velocity", (entries.get(velocity, {}), units)) is not None:
            continue
        for angle in _ANGLE_OF_VELOCITY.values():
            unit = _unit("angle", (entries.get(angle, {}), entries, units))
            if unit in ("deg", "turn"):
                raise ArtifactError(
                    f"{velocity} has no unit, and {angle} is in {unit}",
                    where=f"{where}[joints.{joint}]",
                    remedy=f"give velocity in [units]: {', '.join(SCALES['velocity'])}",
                )


def _time_columns(table: dict[str, Any], units: dict[str, Any], where: str) -> dict[str, Any]:
    """The columns of the time; a list holds those of seconds and of their fractions.

    The unit of time is that of the fractions then, by default ns.
    """
    time = table.get("time")
    if not isinstance(time, list):
        return {"time": time, "time_scale": TIMES[units.get("time", "s")]}
    if "time_bits" in table:
        raise ArtifactError(
            "time is a list, with time_bits",
            where=where,
            remedy="leave time_bits out: its columns are seconds and their fractions",
        )
    return {
        "time": time[0],
        "time_scale": 1.0,
        "subseconds": time[1],
        "subsecond_scale": TIMES[units.get("time", "ns")],
    }


def _base(table: dict[str, Any], units: dict[str, Any], where: str) -> dict[str, Any]:
    """Orientation of the base, from base_quaternion, or from base_roll and base_pitch."""
    given = [name for name in BASE_ANGLES if name in table]
    if "quaternion_order" in table and "base_quaternion" not in table:
        raise ArtifactError(
            "quaternion_order without base_quaternion", where=where, remedy="leave it out"
        )
    if "base" in units and not given:
        raise ArtifactError(
            f"base without {' or '.join(BASE_ANGLES)}",
            where=f"{where}[units]",
            remedy="leave it out",
        )
    if "base_quaternion" in table:
        if given:
            raise ArtifactError(
                f"base_quaternion and {given[0]}", where=where, remedy="give one of the two"
            )
        names = tuple(table["base_quaternion"])
        if table.get("quaternion_order", "wxyz") == "xyzw":
            names = (names[3], *names[:3])
        return {"base_orientation": names}
    if not given:
        return {}

    values = [table.get(name, 0.0) for name in BASE_ANGLES]
    scale = _base_scale(units, given[0], where)
    if all(is_number(value) for value in values):
        return {"base_angles": (scale * values[0], scale * values[1])}
    if len(given) < len(BASE_ANGLES) or any(is_number(value) for value in values):
        raise ArtifactError(
            f"{' and '.join(BASE_ANGLES)} are not two columns or two numbers",
            where=where,
            remedy="give both as names of columns, or both as numbers",
        )
    return {"base_orientation": tuple(values), "base_angle_scale": scale}


def _base_scale(units: dict[str, Any], name: str, where: str) -> float:
    """Rad per unit of roll and pitch, which are often in another unit than the joints.

    ``name`` is that of one of them, for errors.
    """
    if "base" not in units and units.get("angle", "rad") != "rad":
        raise ArtifactError(
            f"{name} has no unit, and angles are in {units['angle']}",
            where=where,
            remedy='give base = "rad" or "deg" in [units]',
        )
    return SCALES["angle"][units.get("base", "rad")]


def _series(table: dict[str, Any], where: str) -> dict[str, str]:
    """Name of the columns of each channel, with a placeholder for the joint."""
    series = {name: table[name] for name in SERIES if isinstance(table.get(name), str)}
    if "joints" in table:  # otherwise the robot has them
        _require_placeholders(series, len(table["joints"]), where)
    return series


def _require_placeholders(series: Mapping[str, str], num_joints: int, where: str) -> None:
    """Raise ArtifactError for a column that several joints would share."""
    for name, column in series.items():
        may_be_shared = name in (*OPERATING_CONDITIONS, *GAINS) or num_joints == 1
        if not may_be_shared and JOINT not in column and NAME not in column:
            raise ArtifactError(
                f"{name} = {column[:40]!r} lacks {JOINT} or {NAME}",
                where=where,
                remedy=f"put {JOINT} in place of the joint's name; pivot a table with a row per "
                f"joint and time; {REMEDY}",
            )


def _check(table: Any, fields: Mapping[str, Field], where: str) -> None:
    Schema(fields, REMEDY, optional=frozenset(fields)).check(table, where)


def _joints(
    table: dict[str, Any], units: dict[str, Any], gain_scale: float, where: str
) -> dict[str, Any]:
    """The joints of the map, or how to read each joint of the robot."""
    # numbers of the map are the gains of all joints that state none
    gains = {name: table[name] for name in GAINS if is_number(table.get(name))}
    _check(gains, {name: _JOINT[name] for name in GAINS}, where)
    if "joints" in table:
        return {"joints": _mapped_joints(table["joints"], gains, units, gain_scale, where)}
    (every_joint,) = _mapped_joints({JOINT: {}}, gains, units, gain_scale, where)
    return {"joints": (), "every_joint": every_joint}


def _mapped_joints(
    tables: dict[str, Any],
    gains: dict[str, float],
    units: dict[str, Any],
    gain_scale: float,
    where: str,
) -> tuple[MappedJoint, ...]:
    """The joints of their tables; ``gains`` are those of joints that state none."""
    joints = []
    for column, table in tables.items():
        place = f"{where}[joints.{column}]"
        _check(table, _JOINT, place)
        conversions = {name: _conversion(name, table, units, place) for name in QUANTITIES}
        name = table.get("name", column)
        given = gains | {gain: table[gain] for gain in GAINS if gain in table}
        scaled = {gain: gain_scale * value for gain, value in given.items()}
        joints.append(MappedJoint(column, name, **scaled, conversions=conversions))

    names = [joint.name for joint in joints]
    repeated_names = {name for name in names if names.count(name) > 1}
    if repeated_names:
        raise ArtifactError(
            f"two joints are named {min(repeated_names)!r}", where=where, remedy="name each once"
        )
    for name in GAINS:
        lacking = [joint.column for joint in joints if getattr(joint, name) is None]
        if 0 < len(lacking) < len(joints):
            problem = f"joint {lacking[0]!r} lacks {name}, others have it"
            raise ArtifactError(problem, where=where, remedy="give all or none")
    return tuple(joints)


def _conversion(
    channel: str, joint: dict[str, Any], units: dict[str, Any], place: str
) -> Conversion:
    """Conversion of a channel of a joint, from the tables of channel and joint, and [units].

    ``joint`` is the table of the joint, ``place`` its name in errors.
    """
    quantity = QUANTITIES[channel]
    changes = joint.get(channel, {})
    _check(changes, _CHANGES | {quantity: _UNITS[quantity]}, f"{place}.{channel}")
    tables = (changes, joint, units) if quantity == "angle" else (changes, units)

    sign = 1 if channel in OPERATING_CONDITIONS else joint.get("sign", 1)
    if channel in _ANGLE_OF_VELOCITY:
        sign = joint.get(_ANGLE_OF_VELOCITY[channel], {}).get("sign", sign)

    merged = ChainMap(*tables)  # the first table with an entry counts
    factor = float(changes.get("sign", sign) * _scale(quantity, tables, place))
    offset = float(merged.get("zero", 0.0))
    if quantity == "angle":  # other quantities are zero at the column value 0
        offset -= factor * float(merged.get("center", 0.0))
    return Conversion(
        factor=factor,
        offset=offset,
        wraps=quantity == "angle" and merged.get("wraps", False),
    )


def _unit(quantity: str, tables: tuple[dict[str, Any], ...]) -> str | float | None:
    """Unit or scale of a quantity, from the first table with one of them; None without."""
    for table in tables:
        if "scale" in table:
            return float(table["scale"])
        if quantity in table:
            return table[quantity]
        if quantity == "angle" and "ticks_per_turn" in table:
            return "tick"
    return None


def _scale(quantity: str, tables: tuple[dict[str, Any], ...], where: str) -> float:
    """SI units per unit of the column, from the first table with a scale or a unit; 1 without."""
    unit = _unit(quantity, tables)
    if unit is None:
        return 1.0
    if not isinstance(unit, str):
        return unit
    if unit != "tick":
        return SCALES[quantity][unit]
    ticks = ChainMap(*tables).get("ticks_per_turn")
    if not ticks:
        raise ArtifactError("angle = 'tick' without ticks_per_turn", where=where, remedy=REMEDY)
    return TURN / ticks
