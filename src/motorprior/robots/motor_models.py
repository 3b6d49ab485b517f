"""Motor models: joints that are driven by the same motor, perhaps behind different gears.

A robot file names the models in a table ``[motors]``, one line per model (docs/your-robot.md).
Constants at the joint are those at the output shaft of the motor, times gear**GEAR_POWERS.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motorprior.bounds import TABLE, TEXT, Field, is_number, many
from motorprior.exceptions import ArtifactError
from motorprior.schema import Schema

# constants that a maker states, and their units
STATED = {"torque_limit": "N·m", "max_speed": "rad/s", "armature": "kg·m²"}
# power of the gear ratio by which a constant at the joint exceeds the constant of the motor
GEAR_POWERS = {
    **dict.fromkeys(
        ("kp", "armature", "viscous_damping", "gear_stiffness", "gear_damping"),
        2.0,
    ),
    **dict.fromkeys(("bristle_stiffness", "output_damping"), 2.0),
    **dict.fromkeys(("torque_limit", "coulomb", "stribeck_torque"), 1.0),
    **dict.fromkeys(("stall_torque", "integral_limit"), 1.0),
    **dict.fromkeys(("profile_speed", "profile_acceleration", "no_load_speed"), -1.0),
    **dict.fromkeys(("backlash", "dead_zone"), -1.0),
}


@dataclass(frozen=True)
class StatedValue:
    """A value of a data sheet, at the output shaft of the motor."""

    value: float
    std: float  # of the logarithm of the true value


@dataclass(frozen=True)
class MotorModel:
    """The motor of one joint."""

    name: str  # motors of the same name are of one model
    gear: float = 1.0  # turns of the motor's output shaft per turn of the joint [-]
    torque_limit: StatedValue | None = None  # [N·m]
    max_speed: StatedValue | None = None  # without load [rad/s]
    armature: StatedValue | None = None  # inertia of the rotor at the output shaft [kg·m²]

    def as_json(self) -> dict[str, Any]:
        """The entries of a header."""
        entries: dict[str, Any] = {"name": self.name, "gear": self.gear}
        for name in STATED:
            stated = getattr(self, name)
            if stated is not None:
                entries[name] = [stated.value, stated.std]
        return entries

    @classmethod
    def from_json(cls, entries: Mapping[str, Any]) -> "MotorModel":
        """The model with these entries, see `as_json`."""
        stated = {name: StatedValue(*entries[name]) for name in STATED if name in entries}
        return cls(entries["name"], entries["gear"], **stated)


def _is_stated(value: Any) -> bool:
    is_pair = isinstance(value, list) and len(value) == 2
    return is_pair and is_number(value[0], 1e-12, 1e9) and is_number(value[1], 1e-3, 3.0)


# Stall torques of servos by their maker [N·m]: XL330 at 5 V, XL-320 at 7.4 V, others at 12 V
# (ROBOTIS e-Manual). Lower case names are those of Rhoban/bam.
_STALL_TORQUES = {
    "xl330": 0.52,
    "XL330-M288": 0.52,
    "xl320": 0.39,
    "mx64": 6.0,
    "mx106": 8.4,
}
# Standard deviation of the logarithm of a torque limit about the stall torque: assumption. The
# firmware's limits of duty and current, the supply, and friction change it. It is not scaled by the
# supply: fits of the XL330 at 7.3 V find 0.55 to 0.61 N·m, perhaps since its current is limited.
_STALL_TORQUE_STD = 0.3


def known_motor(name: str) -> MotorModel | None:
    """The motor of this name, if its maker states the stall torque."""
    if name not in _STALL_TORQUES:
        return None
    return MotorModel(name, torque_limit=StatedValue(_STALL_TORQUES[name], _STALL_TORQUE_STD))


_STATED = Field("[value, standard deviation of its logarithm, 0.001 to 3]", _is_stated)
_GEAR = Field("a number from 0.001 to 1000", lambda value: is_number(value, 1e-3, 1e3))
_GEARS = Field(
    "a gear ratio, or a list of such",
    lambda value: _GEAR.accepts(value) or many(_GEAR, 1).accepts(value),
)
_OPTIONAL = {"joints": many(TEXT, 1), "gear": _GEARS, **dict.fromkeys(STATED, _STATED)}
_MODEL = Schema(_OPTIONAL, "see docs/your-robot.md", frozenset(_OPTIONAL))


def is_header_entry(entries: Any) -> bool:
    """Whether a header may hold these entries of a `MotorModel`."""
    if not TABLE.accepts(entries) or not set(entries) <= {"name", "gear", *STATED}:
        return False
    is_named = TEXT.accepts(entries.get("name")) and _GEAR.accepts(entries.get("gear"))
    return is_named and all(_is_stated(entries[name]) for name in STATED if name in entries)


def motor_models(
    tables: Mapping[str, Any], joint_names: Sequence[str], per_leg: int, where: str
) -> tuple[MotorModel, ...]:
    """The motor of each joint, from the table ``[motors]`` of a robot file.

    ``per_leg`` is the number of joints of a leg. Raises ArtifactError, which names the model and
    the joint.
    """
    motors: dict[str, MotorModel] = {}
    for name, table in tables.items():
        place = f"{where}[motors.{name}]"
        _MODEL.check(table, place)
        joints = table.get("joints", list(joint_names))
        for joint in joints:
            if joint not in joint_names:
                remedy = f"give some of {', '.join(joint_names)}"
                raise ArtifactError(f"no joint {joint!r}", where=place, remedy=remedy)
            if joint in motors:
                problem = f"joint {joint!r} has two motors"
                raise ArtifactError(problem, where=place, remedy="name it in one model")

        stated = {key: StatedValue(*map(float, table[key])) for key in STATED if key in table}
        gears = table.get("gear", 1.0)
        gears = gears if isinstance(gears, list) else [gears]
        if len(gears) not in {1, per_leg, len(joints)} or len(joints) % len(gears):
            remedy = f"give 1 or {len(joints)} ratios, in the order of its joints"
            raise ArtifactError(f"gear has {len(gears)} values", where=place, remedy=remedy)
        for index, joint in enumerate(joints):
            motors[joint] = MotorModel(name, float(gears[index % len(gears)]), **stated)

    without = [joint for joint in joint_names if joint not in motors]
    if tables and without:
        problem = f"joint {without[0]!r} has no motor"
        raise ArtifactError(problem, where=f"{where}[motors]", remedy="name it in one model")
    return tuple(motors[joint] for joint in joint_names) if tables else ()
