"""A column map: the small TOML file that says what the columns of somebody's table mean, in which units and signs.

    motor = "Feetech STS3215"
    time = "t_ms"
    position_target = "goal_{joint}"        # {joint}: the names of the tables [joints.…]
    joint_pos = "present_{joint}"

    [units]
    time = "ms"
    angle = "tick"
    ticks_per_turn = 4096

    [firmware]                              # registers that all these motors were told, where they are known
    profile_acceleration = 39               # rad/s²; profile_speed [rad/s], dead_zone [rad]

    [joints.1]
    name = "shoulder_pan"                   # of the robot's joint, if the columns have another name
    sign = -1
    zero = 0.05                             # the joint's angle [rad] where the column says 0
    kp = 20                                 # gains that the motor was told, in units.gain: N·m/rad or firmware
    kd = 0.5

An angle is sign·unit·value + zero, a velocity or torque sign·unit·value. ``action[{joint}]`` is one number of a column
of lists.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.logs.motor_log import ENCODERS, FIRMWARE, GAIN_UNITS, PHYSICAL_GAINS, is_register
from motorprior.outside_files import read_toml
from motorprior.schema import TABLE, TEXT, Field, Schema, integer, number, one_of, require

TURN = 2.0 * math.pi
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ANGLES = {"rad": 1.0, "deg": TURN / 360.0, "turn": TURN, "tick": math.nan}
VELOCITIES = {"rad/s": 1.0, "deg/s": TURN / 360.0, "rpm": TURN / 60.0}
TORQUES = {"N·m": 1.0, "mN·m": 1e-3, "kg·cm": 0.0980665}
SERIES = (
    "position_target", "joint_pos", "joint_vel", "joint_torque", "external_torque", "load_inertia", "load_stiffness",
)  # fmt: skip
"""Channels that have a column for every joint."""
JOINT = "{joint}"
_REMEDY = "see docs/your-motors.md"
_MOST_JOINTS, _LONGEST_NAME = 1000, 200
"""Every channel has a column per joint, whose name holds the joint's."""
_NAME = Field(
    f"a text of at most {_LONGEST_NAME} letters", lambda value: TEXT.accepts(value) and len(value) <= _LONGEST_NAME
)
_MAP = Schema(
    {
        **dict.fromkeys(("motor", "robot", "time", "segment", *SERIES), _NAME),
        "encoder": one_of(*ENCODERS),
        **dict.fromkeys(("units", "firmware", "joints"), TABLE),
    },
    _REMEDY,
    optional=frozenset({"robot", "segment", "encoder", "units", "firmware", *SERIES[2:]}),
)
_UNITS = Schema(
    {
        "time": one_of(*TIMES), "angle": one_of(*ANGLES), "velocity": one_of(*VELOCITIES), "torque": one_of(*TORQUES),
        "ticks_per_turn": integer(2, 2**31 - 1), "gain": one_of(*GAIN_UNITS),
    },
    _REMEDY,
    optional=frozenset({"time", "angle", "velocity", "torque", "ticks_per_turn", "gain"}),
    name="units",
)  # fmt: skip
_FIRMWARE = Schema(
    {
        name: Field(f"0 (off) or a number from {least:g} to {most:g}", partial(is_register, name))
        for name, (least, most) in FIRMWARE.items()
    },
    _REMEDY,
    optional=frozenset(FIRMWARE),
    name="firmware",
)  # fmt: skip
_JOINT = Schema(
    {
        "name": _NAME,
        "sign": integer(-1, 1),
        "zero": number(-TURN, TURN, unit="rad"),
        "kp": number(1e-6, 1e6),
        "kd": number(0.0, 1e6),
    },
    _REMEDY,
    optional=frozenset({"name", "sign", "zero", "kp", "kd"}),
)


@dataclass(frozen=True)
class MappedJoint:
    """A joint of the table: its name in the columns, the robot's name for it, its sign, its zero [rad], its gains."""

    column: str
    name: str
    sign: float = 1.0
    zero: float = 0.0
    kp: float | None = None
    kd: float | None = None


@dataclass(frozen=True)
class ColumnMap:
    """What the columns of a table mean.

    Attributes:
        source: file or name of the map.
        motor: motor model.
        robot: name of the robot, if the map says it.
        encoder: where angles are measured, "joint" or "rotor".
        time: column of the time.
        segment: column of the number of the recording, or None for a single one.
        series: channel -> name of its columns, with JOINT where the joint's name stands.
        joints: in the order of the map.
        scales: channel -> SI units per unit of its columns.
        gain_unit: of the joints' gains (`MotorLog`).
        firmware: registers of all the motors (`MotorLog`).
    """

    source: str
    motor: str
    robot: str
    encoder: str
    time: str
    segment: str | None
    series: dict[str, str]
    joints: tuple[MappedJoint, ...]
    scales: dict[str, float]
    gain_unit: str = PHYSICAL_GAINS
    firmware: Mapping[str, float] = field(default_factory=dict)

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
    return files("motorprior.logs").joinpath("maps")


def _from_table(table: dict[str, Any], where: str) -> ColumnMap:
    _MAP.check(table, where)
    units = table.get("units", {})
    _UNITS.check(units, where)
    firmware = table.get("firmware", {})
    _FIRMWARE.check(firmware, where)
    series = {name: table[name] for name in SERIES if name in table}
    for name, column in series.items():
        if JOINT not in column:
            raise ArtifactError(f"{name} = {column[:40]!r} lacks {JOINT}", where=where, remedy=_REMEDY)
    return ColumnMap(
        where, table["motor"], table.get("robot", ""), table.get("encoder", "joint"), table["time"],
        table.get("segment"), series, _joints(table["joints"], where), _scales(units, where),
        units.get("gain", PHYSICAL_GAINS), firmware,
    )  # fmt: skip


def _joints(table: dict[str, Any], where: str) -> tuple[MappedJoint, ...]:
    if not table:
        raise ArtifactError("no table [joints.…]", where=where, remedy=_REMEDY)
    if len(table) > _MOST_JOINTS:
        raise ArtifactError(f"{len(table)} joints, more than {_MOST_JOINTS}", where=where, remedy=_REMEDY)
    found = []
    for column, joint in table.items():
        require("a table [joints.NAME]: NAME", column, _NAME, where, _REMEDY)
        _JOINT.check(joint, f"{where}[joints.{column}]")
        if joint.get("sign", 1) == 0:
            raise ArtifactError("sign = 0 is not 1 or -1", where=f"{where}[joints.{column}]", remedy=_REMEDY)
        sign, zero = float(joint.get("sign", 1)), float(joint.get("zero", 0.0))
        found.append(MappedJoint(column, joint.get("name", column), sign, zero, joint.get("kp"), joint.get("kd")))
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


def _scales(units: dict[str, Any], where: str) -> dict[str, float]:
    angle = ANGLES[units.get("angle", "rad")]
    if math.isnan(angle):
        if "ticks_per_turn" not in units:
            raise ArtifactError("angle = 'tick' without ticks_per_turn", where=where, remedy=_REMEDY)
        angle = TURN / units["ticks_per_turn"]
    torque = TORQUES[units.get("torque", "N·m")]
    return {
        "time": TIMES[units.get("time", "s")], "position_target": angle, "joint_pos": angle,
        "joint_vel": VELOCITIES[units.get("velocity", "rad/s")], "joint_torque": torque, "external_torque": torque,
        "load_inertia": 1.0, "load_stiffness": 1.0,
    }  # fmt: skip
