"""Load a robot by name, or from a TOML next to its MJCF or URDF (docs/your-robot.md)."""

import math
import re
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motorprior.artifacts import read_toml
from motorprior.bounds import TABLE, TEXT, Field, is_number, many, number, one_of
from motorprior.exceptions import ArtifactError
from motorprior.robots.model_source import ModelFile
from motorprior.robots.motor_models import motor_models
from motorprior.robots.robot import GRAVITY, Gait, Joint, Leg, Robot
from motorprior.robots.servos import ServoChain
from motorprior.robots.shipped import SHIPPED
from motorprior.schema import Schema

if TYPE_CHECKING:
    from motorprior.robots.user_model import UserModel

_SEE = "see docs/your-robot.md"
_DEFAULT_CLOCKS = {"physics_dt": 0.002, "control_dt": 0.01, "twin_physics_dt": 0.001}
_POSITIVE = number(1e-9, 1e9)
_FILLED_TEXT = Field("a text", lambda value: isinstance(value, str) and bool(value))


def _is_new_name(value: Any) -> bool:
    is_name = isinstance(value, str) and re.fullmatch(r"[A-Za-z0-9_-]+", value) is not None
    return is_name and value not in {shipped.name for shipped in SHIPPED}


def _per_joint_field(field: Field) -> Field:
    listed = many(field, 1)
    return Field(
        f"{field.meaning}, or a list of such",
        lambda value: field.accepts(value) or listed.accepts(value),
    )


def _pair(meaning: str, minimum: Field, maximum: Field) -> Field:
    def accepts(value: Any) -> bool:
        pair = isinstance(value, list) and len(value) == 2
        return (
            pair
            and minimum.accepts(value[0])
            and maximum.accepts(value[1])
            and value[0] <= value[1]
        )

    return Field(f"[min, max] {meaning}", accepts)


_INTEGERS = many(Field("an integer", lambda value: type(value) is int), 1)
_SIGNS = many(Field("1 or -1", lambda value: type(value) is int and value in (1, -1)), 1)
_PER_JOINT = {
    "nominal_pose": _per_joint_field(number(-1e9, 1e9)),
    "torque_limit": _per_joint_field(_POSITIVE),
}
_GAINS = {
    "kp": _per_joint_field(_POSITIVE),
    "kd": _per_joint_field(number(0.0, 1e9)),
}
_OPTIONAL = {
    **_GAINS,
    "encoder": one_of("joint", "rotor"),
    "actuators": one_of("remove"),
    "load_inertia": _pair("in kg·m²", _POSITIVE, _POSITIVE),
    "joint_classes": _per_joint_field(_FILLED_TEXT),
    **dict.fromkeys(("foot_friction", "reference_torque"), _POSITIVE),
    **dict.fromkeys(_DEFAULT_CLOCKS, number(1e-5, 1.0)),
    **dict.fromkeys(("legs", "gait", "servos", "motors"), TABLE),
}
_NAME = Field("a name of letters, digits, '_' and '-' that no shipped robot has", _is_new_name)
_REQUIRED = {
    "name": _NAME,
    "motor": _FILLED_TEXT,
    "model": _FILLED_TEXT,
    "base": one_of("free", "fixed"),
    **_PER_JOINT,
}
_ROBOT = Schema(_REQUIRED | _OPTIONAL, _SEE, frozenset(_OPTIONAL))
_PHASE = Field("a number in [0, 1)", lambda value: is_number(value, 0.0, 1.0) and value < 1.0)
_LEG = Schema({"joints": many(TEXT, 3), "foot": _FILLED_TEXT, "phase": _PHASE}, _SEE)
_SERVOS = Schema(
    {
        "model": _FILLED_TEXT,
        "ids": _INTEGERS,
        "signs": _SIGNS,
        "zeros": _INTEGERS,
        "fleet": _FILLED_TEXT,
        "rest": many(number(-100.0, 100.0), 1),
    },
    "see docs/hardware.md",
    optional=frozenset({"fleet", "rest"}),
    name="servos",
)
_GAIT = Schema(
    {
        "frequency": number(0.2, 10.0),
        "swing_height": number(1e-3, 1.0),
        "forward": _pair(
            "speed in m/s with min <= 0 < max", number(-10.0, 0.0), number(above=0.0, maximum=10.0)
        ),
        "yaw_rate": number(0.01, 10.0),
        "residual": number(0.0, 3.0),
    },
    _SEE,
    frozenset(field.name for field in fields(Gait)),
    "gait",
)


def load_robot(name_or_path: str | Path) -> Robot:
    """Load a shipped robot by name, such as "pupper_v2", or your own by the path of its TOML.

    docs/your-robot.md describes the TOML. Raises ArtifactError, which names file, key and joint.
    """
    path = Path(name_or_path)
    shipped = {robot.name: robot for robot in SHIPPED}
    if path.suffix == ".toml":
        return _from_table(read_toml(path, _SEE), path)
    if str(name_or_path) not in shipped:
        remedy = f"use one of {', '.join(shipped)}, or the path of a .toml file"
        raise ArtifactError(f"no robot {str(name_or_path)!r}", remedy=remedy)
    return shipped[str(name_or_path)]


def as_robot(robot: Robot | str | Path) -> Robot:
    """The robot itself, or `load_robot` of its name or path."""
    return robot if isinstance(robot, Robot) else load_robot(robot)


def _from_table(table: dict[str, Any], path: Path) -> Robot:
    # here, since a robot's own computer has no MuJoCo
    from motorprior.robots.user_model import UserModel
    from motorprior.robots.user_urdf import user_urdf

    _ROBOT.check(table, path)
    where = str(path)
    leg_tables = table.get("legs", {})
    for name, leg_table in leg_tables.items():
        _LEG.check(leg_table, f"{where}[legs.{name}]")

    file = path.parent / table["model"]
    feet = [leg_table["foot"] for leg_table in leg_tables.values()]
    model = UserModel(file, table["base"] == "free", "actuators" in table, feet)
    limits = model.limits()
    names = tuple(limits)

    # numbers and classes per joint
    per_leg = len(names) // max(1, len(leg_tables))
    _require_gains(table, where)
    numbers = {
        key: _per_joint(key, table.get(key, math.nan), len(names), per_leg, where)
        for key in (*_PER_JOINT, *_GAINS)
    }
    classes: tuple[str, ...] = ()
    if "joint_classes" in table:
        given_classes = table["joint_classes"]
        classes = _per_joint("joint_classes", given_classes, len(names), per_leg, where)
    pose = dict(zip(names, numbers["nominal_pose"], strict=True))
    joints = _joints(limits, numbers, where)

    legs = tuple(
        _leg(name, leg_table, names, pose, model, f"{where}[legs.{name}]")
        for name, leg_table in leg_tables.items()
    )
    _require_distinct_legs(leg_tables, where)
    leg_mismatches = [model.leg_mismatch(leg, names, pose) for leg in legs]
    first_mismatch = next((text for text in leg_mismatches if text), "")

    height = model.standing_height(pose, [leg.foot for leg in legs]) if legs else 0.0
    source = ModelFile.of(file, partial(user_urdf, file, feet) if legs else None)
    load_inertia = table.get("load_inertia")
    if load_inertia is None:
        load_inertia = model.load_inertia(pose, len(legs), height)
    low, high = load_inertia
    median_limit = sorted(numbers["torque_limit"])[len(names) // 2]
    return Robot(
        name=table["name"],
        motor=table["motor"],
        joints=joints,
        base=table["base"],
        model=source,
        num_links=model.num_links,
        nominal=numbers["nominal_pose"],
        encoder=table.get("encoder", "joint"),
        legs=legs,
        leg_mismatch=first_mismatch,
        gait=_gait(table.get("gait", {}), legs, numbers["nominal_pose"], path),
        load_inertia=(float(low), float(high)),
        given_classes=classes,
        motor_models=motor_models(table.get("motors", {}), names, per_leg, where),
        files=(path, *source.files),
        weight=GRAVITY * model.mass,
        standing_height=height,
        min_base_height=0.3 * height,
        max_base_height=3.5 * height if legs else 1e3,
        suspended_height=2.0 * height,
        reference_torque=float(table.get("reference_torque", 0.8 * median_limit)),
        foot_friction=float(table.get("foot_friction", 0.6)),
        servos=_servos(table.get("servos"), len(names), path),
        **_clocks(table, where),
    )


def _require_gains(table: dict[str, Any], where: str) -> None:
    """Raise ArtifactError for one gain without the other, or legs, which need gains to stand."""
    missing = [key for key in _GAINS if key not in table]
    if missing and (len(missing) < len(_GAINS) or table.get("legs")):
        remedy = "give kp and kd; only a robot without legs may leave out both"
        raise ArtifactError(f"no {' and no '.join(missing)}", where=where, remedy=remedy)


def _joints(
    limits: dict[str, tuple[float, float]], numbers: dict[str, tuple[Any, ...]], where: str
) -> tuple[Joint, ...]:
    joints = []
    for index, (name, (lower, upper)) in enumerate(limits.items()):
        angle = numbers["nominal_pose"][index]
        if not lower <= angle <= upper:
            problem = (
                f"nominal_pose {angle:g} rad of joint {name!r} is outside its limits "
                f"{lower:g} to {upper:g} rad"
            )
            remedy = "give an angle within the limits of the model"
            raise ArtifactError(problem, where=where, remedy=remedy)

        joint = Joint(
            name=name,
            lower=lower,
            upper=upper,
            kp=numbers["kp"][index],
            kd=numbers["kd"][index],
            torque_limit=numbers["torque_limit"][index],
        )
        joints.append(joint)
    return tuple(joints)


def _require_distinct_legs(leg_tables: dict[str, Any], where: str) -> None:
    """Raise ArtifactError if two legs have the same joint or foot."""
    names: list[str] = []
    for leg_table in leg_tables.values():
        names += [*leg_table["joints"], f"foot {leg_table['foot']}"]
    shared = [name for name in names if names.count(name) > 1]
    if shared:
        problem = f"two legs share {shared[0]!r}"
        raise ArtifactError(problem, where=where, remedy="give every leg its own")


def _leg(
    name: str,
    table: Any,
    names: tuple[str, ...],
    pose: dict[str, float],
    model: "UserModel",
    where: str,
) -> Leg:
    joints = tuple(table["joints"])
    if len(joints) != 3 or len(set(joints) & set(names)) != 3:
        remedy = f"give abduction, hip and knee, of {', '.join(names)}"
        raise ArtifactError(
            f"joints {list(joints)} are not three joints of the robot", where=where, remedy=remedy
        )
    indices = (names.index(joints[0]), names.index(joints[1]), names.index(joints[2]))
    geometry = model.leg_geometry(joints, table["foot"], pose)
    return Leg(name, indices, table["foot"], float(table["phase"]), *geometry)


def _clocks(table: dict[str, Any], where: str) -> dict[str, Any]:
    clocks = {key: float(table.get(key, default)) for key, default in _DEFAULT_CLOCKS.items()}
    for key in ("physics_dt", "twin_physics_dt"):
        steps = clocks["control_dt"] / clocks[key]
        if abs(steps - round(steps)) > 1e-6:
            problem = (
                f"{key} {clocks[key]:g} s does not divide control_dt {clocks['control_dt']:g} s"
            )
            raise ArtifactError(problem, where=where, remedy="give a step that does")
    return clocks


def _gait(table: Any, legs: tuple[Leg, ...], pose: tuple[float, ...], path: Path) -> Gait | None:
    _GAIT.check(table, path)
    if not legs:
        return None
    hip_heights = [leg.hip_height(np.array(pose)) for leg in legs]
    gait = Gait.of_size(float(np.mean(hip_heights)))
    for key, value in table.items():
        gait = replace(gait, **{key: _floats(value)})
    return gait


def _servos(table: Any, count: int, path: Path) -> ServoChain | None:
    if table is None:
        return None
    _SERVOS.check(table, path)
    for key in ("ids", "signs", "zeros", "rest"):
        values = table.get(key, [0] * count)
        if len(values) != count:
            raise ArtifactError(
                f"{key} has {len(values)} values",
                where=f"{path}[servos]",
                remedy=f"give {count}, in the order of the joints",
            )
    if len(set(table["ids"])) < count:
        raise ArtifactError("two servos have one id", where=f"{path}[servos]", remedy="correct ids")
    return ServoChain(
        model=table["model"],
        ids=tuple(table["ids"]),
        signs=tuple(table["signs"]),
        zeros=tuple(table["zeros"]),
        fleet=table.get("fleet", ""),
        rest=tuple(map(float, table.get("rest", ()))),
    )


def _floats(value: Any) -> Any:
    """A number or a list of numbers, as floats."""
    return tuple(map(float, value)) if isinstance(value, list) else float(value)


def _per_joint(key: str, value: Any, count: int, per_leg: int, where: str) -> tuple[Any, ...]:
    """One value per joint, from one value, one per joint of a leg, or one per joint.

    A single value is for all joints; the values of a leg are for the joints of every leg.
    """
    values = tuple(value if isinstance(value, list) else [value])
    allowed_counts = sorted({1, per_leg, count})
    if len(values) not in allowed_counts:
        remedy = f"give {' or '.join(map(str, allowed_counts))} values"
        raise ArtifactError(f"{key} has {len(values)} values", where=where, remedy=remedy)
    values = tuple(float(entry) if is_number(entry) else entry for entry in values)
    repeats = count // len(values)
    return values * repeats
