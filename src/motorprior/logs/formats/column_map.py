"""A column map: the small TOML file that says what the columns of somebody's table mean, in which units and signs.

    motor = "Feetech STS3215"
    time = "t_ms"
    position_target = "goal_{joint}"        # {joint}: the names of the tables [joints.…]
    joint_pos = "present_{joint}"
    posture = "suspended"                        # of the base in all rows; or the column that says it in every row
    supply_voltage = 7.4                    # of all motors [V]; or a column, of all joints or with {joint} in its name
    motor_temperature = "temp_{joint}"      # °C; or a number, too

    [units]
    time = "ms"
    angle = "tick"
    ticks_per_turn = 4096
    voltage = "dV"                          # of supply_voltage

    [firmware]                              # registers that all these motors were told, where they are known
    profile_acceleration = 39               # rad/s²; profile_speed [rad/s], dead_zone [rad]

    [joints.1]
    name = "shoulder_pan"                   # of the robot's joint, if the columns have another name
    sign = -1
    zero = 0.05                             # the joint's angle [rad] where the column says 0
    kp = 20                                 # gains that the motor was told, in units.gain: N·m/rad or firmware
    kd = 0.5

``{name}`` in the name of a column stands for the joint's name. An angle is sign·unit·value + zero, a velocity or torque
sign·unit·value. ``action[{joint}]`` is one number of a column of lists. A joint may have units of its own, ``scale``
[rad per unit of its columns] where its unit has no name, and a table per channel that has other ones,
``[joints.1.joint_pos]``; a velocity has the sign of the angle. Where no column says the time, ``rate`` [Hz] stands for
``time``; time stamps are read as they are. ``posture`` is one of POSTURES, or else the name of a column of such names.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import is_number
from motorprior.exceptions import ArtifactError
from motorprior.files import read_toml
from motorprior.logs.formats.column_units import (
    OF_ANGLES,
    QUANTITIES,
    TIMES,
    UNITS,
    VOLTAGES,
    Conversion,
    conversions,
    require_ticks,
)
from motorprior.logs.motor_log import (
    CONDITIONS,
    ENCODERS,
    FIRMWARE,
    GAIN_UNITS,
    PHYSICAL_GAINS,
    POSTURES,
    is_register,
)
from motorprior.schema import TABLE, TEXT, Field, Schema, number, one_of, require

SERIES = (*QUANTITIES, "load_inertia", "load_stiffness")
"""Channels that have a column for every joint."""
JOINT, NAME = "{joint}", "{name}"
"""In the name of a column: the joint's table [joints.…], and its name (the same, unless the table has a name)."""
KP, KD = (1e-6, 1e6), (0.0, 1e6)
"""Least and most of a stated gain."""
_REMEDY = "see docs/your-motors.md"
_PIVOT = f"put {JOINT} where its columns have the joint's name; a table with a row per joint and time: pivot it"
_MOST_JOINTS, _LONGEST_NAME = 1000, 200
"""Every channel has a column per joint, whose name holds the joint's."""
_NAME = Field(
    f"a text of 1 to {_LONGEST_NAME} letters", lambda value: TEXT.accepts(value) and 0 < len(value) <= _LONGEST_NAME
)
_CONDITION = {
    name: Field(
        f"the name of a column, or a number within {least:g}..{most:g}",
        lambda value, least=least, most=most: _NAME.accepts(value) or is_number(value, least, most),
    )
    for name, (least, most) in CONDITIONS.items()
}
_MAP = Schema(
    {
        **dict.fromkeys(("motor", "robot", "time", "segment", "posture", *SERIES), _NAME),
        **_CONDITION,
        "rate": number(1e-3, 1e6, unit="Hz"),
        "encoder": one_of(*ENCODERS),
        **dict.fromkeys(("units", "firmware", "joints"), TABLE),
    },
    _REMEDY,
    optional=frozenset({"robot", "time", "rate", "segment", "posture", "encoder", "units", "firmware", *SERIES[2:]}),
)
_UNITS = Schema(
    {**UNITS, "time": one_of(*TIMES), "gain": one_of(*GAIN_UNITS)},
    _REMEDY,
    optional=frozenset({*UNITS, "time", "gain"}),
    name="units",
)
_FIRMWARE = Schema(
    {
        name: Field(f"0 (off) or a number from {least:g} to {most:g}", partial(is_register, name))
        for name, (least, most) in FIRMWARE.items()
    },
    _REMEDY,
    optional=frozenset(FIRMWARE),
    name="firmware",
)
_OF_JOINTS = {
    "name": _NAME,
    **OF_ANGLES,
    "kp": number(*KP),
    "kd": number(*KD),
    **dict.fromkeys(QUANTITIES, TABLE),
}
_JOINT = Schema(_OF_JOINTS, _REMEDY, optional=frozenset(_OF_JOINTS))


@dataclass(frozen=True)
class MappedJoint:
    """A joint of the table: its name in the columns, the robot's name for it, its gains, its columns' conversions.

    ``conversions`` has those of QUANTITIES; a channel without one is in SI units.
    """

    column: str
    name: str
    kp: float | None = None
    kd: float | None = None
    conversions: Mapping[str, Conversion] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """What the columns of a table mean.

    Attributes:
        source: file or name of the map.
        motor: motor model.
        robot: name of the robot, if the map says it.
        encoder: where angles are measured, "joint" or "rotor"; empty if the map does not say it.
        time: column of the time, or None where ``rate`` stands for it.
        time_scale: seconds per unit of that column.
        rate: of the rows [Hz], or None.
        segment: column of the number of the recording, or None for a single one.
        posture: one of POSTURES, which holds for all rows, or else the column that says it; None if nobody says it.
        series: channel -> name of its columns, with JOINT or NAME where the joint's stands; of CONDITIONS it may be
            the column of all joints.
        conditions: those of CONDITIONS that hold for all rows and joints.
        joints: in the order of the map.
        gain_unit: of the joints' gains (`MotorLog`).
        firmware: registers of all the motors (`MotorLog`).
    """

    source: str
    motor: str
    robot: str
    series: dict[str, str]
    joints: tuple[MappedJoint, ...]
    encoder: str = ""
    time: str | None = None
    time_scale: float = 1.0
    rate: float | None = None
    segment: str | None = None
    posture: str | None = None
    conditions: Mapping[str, float] = field(default_factory=dict)
    gain_unit: str = PHYSICAL_GAINS
    firmware: Mapping[str, float] = field(default_factory=dict)

    @property
    def posture_column(self) -> str | None:
        """Name of the column of postures; None if one holds for all rows, or if nobody says it."""
        return None if self.posture in POSTURES else self.posture

    def columns_of(self, channel: str, joints: Iterable[MappedJoint]) -> list[str]:
        """Names of the columns of a channel, one per joint."""
        return [self.series[channel].replace(JOINT, joint.column).replace(NAME, joint.name) for joint in joints]

    def gains(self, joints: tuple[MappedJoint, ...]) -> dict[str, np.ndarray]:
        """(J,) of the channels stated_kp and stated_kd of these joints, as far as they are stated."""
        found = {f"stated_{name}": [getattr(joint, name) for joint in joints] for name in ("kp", "kd")}
        return {name: np.array(values) for name, values in found.items() if None not in values}


def shipped_maps() -> tuple[str, ...]:
    """Names of the maps that come with motorprior."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _folder().iterdir() if file.name.endswith(".toml")))


def load_column_map(name_or_path: str | Path) -> ColumnMap:
    """A shipped map by its name, or that of a .toml file.

    Raises:
        ArtifactError: no such map or file, not TOML, or an entry that is not understood; names the key and its value.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        if str(name_or_path) not in shipped_maps():
            known = ", ".join(shipped_maps())
            raise ArtifactError(
                f"no column map {str(name_or_path)!r}", remedy=f"use one of {known}, or the path of a .toml file"
            )
        text = _folder().joinpath(f"{name_or_path}.toml").read_text(encoding="utf-8")
        return _from_table(tomllib.loads(text), str(name_or_path))
    return _from_table(read_toml(path, _REMEDY), str(path))


def _folder() -> Any:
    return files("motorprior.logs.formats").joinpath("maps")


def _from_table(table: dict[str, Any], where: str) -> ColumnMap:
    if "joint" in table:
        problem = "joint: a table with a row per joint and time is not read"
        raise ArtifactError(problem, where=where, remedy=f"pivot it to a row per time; {_REMEDY}")
    _MAP.check(table, where)
    units = table.get("units", {})
    _UNITS.check(units, where)
    firmware = table.get("firmware", {})
    _FIRMWARE.check(firmware, where)
    _require_one_clock(table, units, where)
    series = _series(table, where)
    return ColumnMap(
        source=where, motor=table["motor"], robot=table.get("robot", ""), encoder=table.get("encoder", ""),
        time=table.get("time"), time_scale=TIMES[units.get("time", "s")], rate=table.get("rate"),
        segment=table.get("segment"), posture=table.get("posture"), series=series,
        joints=_joints(table["joints"], units, series, where),
        gain_unit=units.get("gain", PHYSICAL_GAINS), firmware=firmware,
        conditions=_conditions(table, units),
    )  # fmt: skip


def _conditions(table: dict[str, Any], units: dict[str, Any]) -> dict[str, float]:
    """Of CONDITIONS those that are numbers, in V and °C."""
    scale = {"supply_voltage": VOLTAGES[units.get("voltage", "V")]}
    return {name: scale.get(name, 1.0) * table[name] for name in CONDITIONS if is_number(table.get(name))}


def _require_one_clock(table: dict[str, Any], units: dict[str, Any], where: str) -> None:
    if ("time" in table) == ("rate" in table):
        problem = "both time and rate" if "time" in table else "neither time, a column, nor rate [Hz]"
        raise ArtifactError(problem, where=where, remedy="give one of the two")
    if "rate" in table and "time" in units:
        raise ArtifactError("units: time, and no column of times", where=where, remedy="leave it out, or give time")


def _series(table: dict[str, Any], where: str) -> dict[str, str]:
    series = {name: table[name] for name in SERIES if isinstance(table.get(name), str)}
    for name, column in series.items():
        if name not in CONDITIONS and JOINT not in column and NAME not in column:
            raise ArtifactError(
                f"{name} = {column[:40]!r} lacks {JOINT} or {NAME}", where=where, remedy=f"{_PIVOT}; {_REMEDY}"
            )
    if series["position_target"] == series["joint_pos"]:
        problem = f"position_target and joint_pos are both {series['joint_pos'][:40]!r}"
        raise ArtifactError(problem, where=where, remedy="name the columns of commands and those of measured angles")
    return series


def _joints(
    table: dict[str, Any], units: dict[str, Any], series: Mapping[str, str], where: str
) -> tuple[MappedJoint, ...]:
    if not table:
        raise ArtifactError("no table [joints.…]", where=where, remedy=_REMEDY)
    if len(table) > _MOST_JOINTS:
        raise ArtifactError(f"{len(table)} joints, more than {_MOST_JOINTS}", where=where, remedy=_REMEDY)
    found = [_joint(column, joint, units, series, where) for column, joint in table.items()]
    require_ticks(table, units, where)
    names = [joint.name for joint in found]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ArtifactError(f"two joints are named {sorted(twice)[0]!r}", where=where, remedy="name each once")
    for name in ("kp", "kd"):
        stated = [getattr(joint, name) is not None for joint in found]
        if any(stated) and not all(stated):
            odd = found[stated.index(False)].column
            raise ArtifactError(f"joint {odd!r} lacks {name}, others have it", where=where, remedy="state all or none")
    if found[0].kd is not None and found[0].kp is None:
        raise ArtifactError("kd without kp", where=where, remedy="state both, or kp alone")
    return tuple(found)


def _joint(column: str, joint: Any, units: dict[str, Any], series: Mapping[str, str], where: str) -> MappedJoint:
    require("a table [joints.NAME]: NAME", column, _NAME, where, _REMEDY)
    place = f"{where}[joints.{column}]"
    _JOINT.check(joint, place)
    if missing := [name for name in QUANTITIES if name in joint and name not in series]:
        problem = f"a table {missing[0]}, and the map names no columns {missing[0]}"
        raise ArtifactError(problem, where=place, remedy=f'give {missing[0]} = "…{JOINT}", or remove the table')
    known = conversions(joint, units, place)
    return MappedJoint(column, joint.get("name", column), joint.get("kp"), joint.get("kd"), known)
