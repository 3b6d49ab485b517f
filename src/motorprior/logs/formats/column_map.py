"""Column maps: short TOML files that state what the columns of a third-party table mean (docs/your-motors.md).

    motor = "Feetech STS3215"
    time = "t_ms"
    position_target = "goal_{joint}"        # {joint}: the names of the tables [joints.…]
    joint_pos = "present_{joint}"

    [units]
    time = "ms"

    [joints.1]
    name = "shoulder_pan"                   # of the robot's joint

An angle is sign·unit·value + zero, a velocity or torque sign·unit·value; a velocity has the sign of the angle.
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

from motorprior.bounds import TABLE, TEXT, Field, is_number, number, one_of, require
from motorprior.exceptions import ArtifactError
from motorprior.files import read_toml
from motorprior.logs.formats.column_units import (
    OF_ANGLES,
    QUANTITIES,
    REMEDY,
    TIMES,
    UNITS,
    VOLTAGES,
    Conversion,
    conversions,
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
from motorprior.schema import Schema

SERIES = (*QUANTITIES, "load_inertia", "load_stiffness")  # channels with a column per joint
JOINT, NAME = "{joint}", "{name}"  # placeholders in column names
KP, KD = (1e-6, 1e6), (0.0, 1e6)  # bounds of gains
_MAX_JOINTS = 1000
_NAME = Field("a text of 1 to 200 letters", lambda value: TEXT.accepts(value) and 0 < len(value) <= 200)
_CONDITION = {
    name: Field(
        f"the name of a column, or a number from {low:g} to {high:g}",
        lambda value, low=low, high=high: _NAME.accepts(value) or is_number(value, low, high),
    )
    for name, (low, high) in CONDITIONS.items()
}
_MAP = Schema(
    {
        **dict.fromkeys(("motor", "robot", "time", "segment", "posture", *SERIES), _NAME),
        **_CONDITION,
        "rate": number(1e-3, 1e6, unit="Hz"),
        "encoder": one_of(*ENCODERS),
        **dict.fromkeys(("units", "firmware", "joints"), TABLE),
    },
    REMEDY,
    optional=frozenset({"robot", "time", "rate", "segment", "posture", "encoder", "units", "firmware", *SERIES[2:]}),
)
_UNITS = Schema(
    {**UNITS, "time": one_of(*TIMES), "gain": one_of(*GAIN_UNITS)},
    REMEDY,
    optional=frozenset({*UNITS, "time", "gain"}),
    name="units",
)
_FIRMWARE = Schema(
    {
        name: Field(f"0 (off) or a number from {low:g} to {high:g}", partial(is_register, name))
        for name, (low, high) in FIRMWARE.items()
    },
    REMEDY,
    optional=frozenset(FIRMWARE),
    name="firmware",
)
_JOINT_ENTRIES = {
    "name": _NAME,
    **OF_ANGLES,
    "kp": number(*KP),
    "kd": number(*KD),
    **dict.fromkeys(QUANTITIES, TABLE),
}
_JOINT = Schema(_JOINT_ENTRIES, REMEDY, optional=frozenset(_JOINT_ENTRIES))

_MAPS = files("motorprior.logs.formats").joinpath("maps")


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
    """The meaning of the columns of a table.

    Attributes:
        source: file or name of the map.
        motor: motor model.
        robot: name of the robot, or empty.
        series: channel -> name of its columns, with JOINT or NAME; for CONDITIONS it may be one column for all joints.
        joints: in the order of the map.
        encoder: where angles are measured, "joint" or "rotor"; empty if not given.
        time: column of the time, or None with ``rate``.
        time_scale: seconds per unit of that column.
        rate: of the rows [Hz], or None.
        segment: column with the index of the recording, or None.
        posture: one of POSTURES for all rows, or the name of a column, or None.
        conditions: CONDITIONS that hold for all rows and joints.
        gain_unit: of the joints' gains (`MotorLog`).
        firmware: registers of all motors (`MotorLog`).
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
        """Name of the column of postures, if there is one."""
        return None if self.posture in POSTURES else self.posture

    def columns_of(self, channel: str, joints: Iterable[MappedJoint]) -> list[str]:
        """Column names of a channel, one per joint."""
        return [self.series[channel].replace(JOINT, joint.column).replace(NAME, joint.name) for joint in joints]

    def gains(self, joints: tuple[MappedJoint, ...]) -> dict[str, np.ndarray]:
        """(J,) kp and kd of these joints as channels of a log, if given."""
        found = {f"stated_{name}": [getattr(joint, name) for joint in joints] for name in ("kp", "kd")}
        return {name: np.array(values) for name, values in found.items() if None not in values}


def shipped_maps() -> tuple[str, ...]:
    """Names of the maps in the package."""
    return tuple(sorted(file.name.removesuffix(".toml") for file in _MAPS.iterdir() if file.name.endswith(".toml")))


def load_column_map(name_or_path: str | Path) -> ColumnMap:
    """Load a shipped map by name, or a .toml file by path.

    Raises:
        ArtifactError: no such map or file, not TOML, or an unknown or bad entry; names the key and its value.
    """
    path = Path(name_or_path)
    if path.suffix == ".toml":
        return _from_table(read_toml(path, REMEDY), str(path))
    if str(name_or_path) not in shipped_maps():
        remedy = f"use one of {', '.join(shipped_maps())}, or the path of a .toml file"
        raise ArtifactError(f"no column map {str(name_or_path)!r}", remedy=remedy)
    return _from_table(tomllib.loads((_MAPS / f"{name_or_path}.toml").read_text("utf-8")), str(name_or_path))


def _from_table(table: dict[str, Any], where: str) -> ColumnMap:
    if "joint" in table:
        problem = "joint: tables with a row per joint and time are not supported"
        raise ArtifactError(problem, where=where, remedy=f"pivot it to a row per time; {REMEDY}")
    _MAP.check(table, where)
    units, firmware = table.get("units", {}), table.get("firmware", {})
    _UNITS.check(units, where)
    _FIRMWARE.check(firmware, where)
    if ("time" in table) == ("rate" in table):
        problem = "both time and rate" if "time" in table else "neither time, a column, nor rate [Hz]"
        raise ArtifactError(problem, where=where, remedy="give one of the two")
    series = _series(table, where)
    volts = VOLTAGES[units.get("voltage", "V")]
    return ColumnMap(
        source=where, motor=table["motor"], robot=table.get("robot", ""), encoder=table.get("encoder", ""),
        time=table.get("time"), time_scale=TIMES[units.get("time", "s")], rate=table.get("rate"),
        segment=table.get("segment"), posture=table.get("posture"), series=series,
        joints=_joints(table["joints"], units, series, where),
        gain_unit=units.get("gain", PHYSICAL_GAINS), firmware=firmware,
        conditions={
            name: table[name] * (volts if name == "supply_voltage" else 1.0)
            for name in CONDITIONS
            if is_number(table.get(name))
        },
    )  # fmt: skip


def _series(table: dict[str, Any], where: str) -> dict[str, str]:
    series = {name: table[name] for name in SERIES if isinstance(table.get(name), str)}
    for name, column in series.items():
        if name not in CONDITIONS and JOINT not in column and NAME not in column:
            remedy = f"put {JOINT} in place of the joint's name; pivot a table with a row per joint and time; {REMEDY}"
            raise ArtifactError(f"{name} = {column[:40]!r} lacks {JOINT} or {NAME}", where=where, remedy=remedy)
    if series["position_target"] == series["joint_pos"]:
        problem = f"position_target and joint_pos are both {series['joint_pos'][:40]!r}"
        raise ArtifactError(problem, where=where, remedy="name the columns of commands and those of measured angles")
    return series


def _joints(
    table: dict[str, Any], units: dict[str, Any], series: Mapping[str, str], where: str
) -> tuple[MappedJoint, ...]:
    if not 0 < len(table) <= _MAX_JOINTS:
        raise ArtifactError(f"{len(table)} tables [joints.…], not 1 to {_MAX_JOINTS}", where=where, remedy=REMEDY)
    found = tuple(_joint(column, joint, units, series, where) for column, joint in table.items())
    _require_ticks(table, units, where)
    names = [joint.name for joint in found]
    if double := {name for name in names if names.count(name) > 1}:
        raise ArtifactError(f"two joints are named {sorted(double)[0]!r}", where=where, remedy="name each once")
    for name in ("kp", "kd"):
        lacking = [joint.column for joint in found if getattr(joint, name) is None]
        if 0 < len(lacking) < len(found):
            problem = f"joint {lacking[0]!r} lacks {name}, others have it"
            raise ArtifactError(problem, where=where, remedy="give all or none")
    if found[0].kd is not None and found[0].kp is None:
        raise ArtifactError("kd without kp", where=where, remedy="give both, or kp alone")
    return found


def _joint(column: str, joint: Any, units: dict[str, Any], series: Mapping[str, str], where: str) -> MappedJoint:
    require("a table [joints.NAME]: NAME", column, _NAME, where, REMEDY)
    place = f"{where}[joints.{column}]"
    _JOINT.check(joint, place)
    if unused := [name for name in QUANTITIES if name in joint and name not in series]:
        problem = f"a table {unused[0]}, but the map names no columns {unused[0]}"
        raise ArtifactError(problem, where=place, remedy=f'give {unused[0]} = "…{JOINT}", or remove the table')
    known = conversions(joint, units, place)
    return MappedJoint(column, joint.get("name", column), joint.get("kp"), joint.get("kd"), known)


def _require_ticks(joints: Mapping[str, Mapping[str, Any]], units: Mapping[str, Any], where: str) -> None:
    """Reject ticks_per_turn if no angle is in ticks: the user forgot the unit."""
    tables = [units, *joints.values()]
    tables += [joint[name] for joint in joints.values() for name in ("position_target", "joint_pos") if name in joint]
    sizes = [table["ticks_per_turn"] for table in tables if "ticks_per_turn" in table]
    if sizes and not any(table.get("angle") == "tick" for table in tables):
        problem = f"ticks_per_turn = {sizes[0]:g}, but no angle is in ticks"
        raise ArtifactError(problem, where=where, remedy='add angle = "tick" in the same table, or remove it')
