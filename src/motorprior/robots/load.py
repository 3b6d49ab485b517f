"""A robot by name, or from a user's TOML beside their MJCF or URDF.

    name = "go2"                     # short; priors, policies and logs carry it
    motor = "Unitree GO2 joint motor" # name of the motors
    model = "go2.xml"                # MJCF or URDF beside this file
    actuators = "remove"             # take the model's own actuators out; without it they are refused
    base = "free"                    # or "fixed"
    nominal_pose = [0.0, 0.9, -1.8]  # [rad]: a number, one per joint of a leg, or one per joint
    kp = 30.0                        # [N·m/rad] and
    kd = 0.8                         # [N·m·s/rad] at the joint: the same three forms
    torque_limit = 23.7              # [N·m]
    encoder = "joint"                # or "rotor"

    [legs.FR]                        # none for an arm
    joints = ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"]   # abduction, hip, knee
    foot = "FR"                      # a geom
    phase = 0.0                      # in the cycle of a trot

Everything else has a default: `joints` (all hinges of the model), `load_inertia` ([least, most] in kg·m²),
`foot_friction`, `physics_dt`, `control_dt`, `twin_physics_dt`, `reference_torque`, and a table `[gait]` with the fields
of `Gait`.
"""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.files import read_toml
from motorprior.robots.model_files import files_digest, model_files
from motorprior.robots.model_source import ModelFile
from motorprior.robots.robot import GRAVITY, Gait, Joint, Leg, Robot
from motorprior.robots.shipped import SHIPPED
from motorprior.robots.user_model import UserModel
from motorprior.schema import TABLE, TEXT, Field, Schema, many, number, one_of

_NAMED = re.compile(r"[A-Za-z0-9_-]+")
_SEE = "see docs/your-robot.md"
_CLOCKS = {"physics_dt": 0.002, "control_dt": 0.01, "twin_physics_dt": 0.001}
_POSITIVE, _ANY = number(1e-9, 1e9), number(-1e9, 1e9)
_PER_JOINT = Field("a number, or a list of numbers", lambda value: _ANY.accepts(value) or many(_ANY, 1).accepts(value))
_NAME = Field("a text", lambda value: isinstance(value, str) and bool(value))
_ROBOT = Schema(
    {
        **dict.fromkeys(("name", "motor", "model"), _NAME),
        "base": one_of("free", "fixed"),
        "encoder": one_of("joint", "rotor"),
        "actuators": one_of("remove"),
        "joints": many(TEXT, 1),
        "load_inertia": many(_POSITIVE, 2),
        **dict.fromkeys(("nominal_pose", "kp", "kd", "torque_limit"), _PER_JOINT),
        **dict.fromkeys(("foot_friction", "reference_torque"), _POSITIVE),
        **dict.fromkeys(_CLOCKS, number(1e-5, 1.0)),
        **dict.fromkeys(("legs", "gait"), TABLE),
    },
    _SEE,
    frozenset(
        {
            "encoder",
            "actuators",
            "joints",
            "legs",
            "gait",
            "load_inertia",
            "foot_friction",
            "reference_torque",
            *_CLOCKS,
        }
    ),
)
_LEG = Schema({"joints": many(TEXT, 1), "foot": _NAME, "phase": number(0.0, 1.0)}, _SEE)
_GAIT = Schema(
    {
        "frequency": number(0.2, 10.0),
        "swing_height": number(1e-3, 1.0),
        "forward": many(number(-10.0, 10.0), 2),
        "yaw_rate": number(0.01, 10.0),
        "residual": number(0.0, 3.0),
    },
    _SEE,
    frozenset(field.name for field in fields(Gait)),
)
_USUAL_LOAD = 0.8
"""Default reference torque, as a share of the torque limit [-]."""
_LOWEST = 0.3
"""Height of the base below which a robot has fallen [standing heights]."""
_HIGHEST = 3.5
"""Height of the base above which the simulation has failed [standing heights]."""
_SUSPENDED = 2.0
"""Height of a suspended robot's base [standing heights]."""


def load_robot(name_or_path: str | Path) -> Robot:
    """Load a shipped robot by name, or a user's by the path of its TOML (docs/your-robot.md).

    Args:
        name_or_path: ``"pupper_v2"``, or a .toml file beside an MJCF or URDF.

    Returns:
        The frozen description: joints, limits, gains, poses, clocks, and legs where it has any.

    Raises:
        ArtifactError: an unknown name, a file that cannot be read, unknown or missing keys, or a model that does not
            fit; names the file, the joint or key, and the remedy.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        for robot in SHIPPED:
            if robot.name == str(name_or_path):
                return robot
        known = ", ".join(robot.name for robot in SHIPPED)
        raise ArtifactError(
            f"no robot {str(name_or_path)!r}", remedy=f"use one of {known}, or the path of a .toml file"
        )
    robot = _from_table(_read(path), path)
    if robot.name in {shipped.name for shipped in SHIPPED} or not _NAMED.fullmatch(robot.name):
        raise ArtifactError(
            f"name {robot.name!r} is a shipped robot's, or has other characters than letters, digits, '_' and '-'",
            where=path,
            remedy="give it a name of its own: priors, logs and policies carry it",
        )
    return robot


def as_robot(robot: Robot | str | Path) -> Robot:
    """The robot itself, or `load_robot` of its name or path."""
    return robot if isinstance(robot, Robot) else load_robot(robot)


def _read(path: Path) -> dict[str, Any]:
    table = read_toml(path, _SEE)
    _ROBOT.check(table, path)
    return table


def _from_table(table: dict[str, Any], path: Path) -> Robot:
    where, legs = str(path), table.get("legs", {})
    base, encoder = table["base"], table.get("encoder", "joint")
    file = path.parent / table["model"]
    model = UserModel(file, base == "free", "actuators" in table)
    names = model.joint_names(tuple(table["joints"]) if "joints" in table else None)
    if not names:
        raise ArtifactError("the model has no hinges", where=file, remedy="give a model with joints")
    for name, leg in legs.items():
        _LEG.check(leg, f"{where}[legs.{name}]")
    bounds = [model.limits(name) for name in names]
    per_leg = len(names) // max(1, len(legs))
    numbers = {
        key: _numbers(key, table[key], len(names), per_leg, where)
        for key in ("nominal_pose", "kp", "kd", "torque_limit")
    }
    _require_bounds(numbers, names, bounds, where)
    joints = tuple(
        Joint(name, *bounds[i], numbers["kp"][i], numbers["kd"][i], numbers["torque_limit"][i], encoder)
        for i, name in enumerate(names)
    )
    pose = dict(zip(names, numbers["nominal_pose"], strict=True))
    made = tuple(_leg(name, leg, names, pose, model, f"{where}[legs.{name}]") for name, leg in legs.items())
    _require_own(legs, where)
    height = model.standing_height(pose, [leg.foot for leg in made]) if made else 0.0
    others: dict[str, Any] = {
        key: float(table.get(key, default)) for key, default in ({"foot_friction": 0.6} | _CLOCKS).items()
    }
    _require_clocks(others, where)
    files = model_files(file)
    typical = _USUAL_LOAD * sorted(numbers["torque_limit"])[len(names) // 2]
    return Robot(
        name=table["name"],
        motor=table["motor"],
        joints=joints,
        base=base,
        model=ModelFile(files, files_digest(files)),
        num_links=model.num_links,
        nominal=numbers["nominal_pose"],
        legs=made,
        unlike=next(filter(None, (model.unlike(leg, names, pose) for leg in made)), ""),
        gait=_gait(table.get("gait", {}), made, numbers["nominal_pose"], f"{where}[gait]"),
        load_inertia=_loads(table["load_inertia"], where)
        if "load_inertia" in table
        else model.load_inertia(pose, len(made), height),
        files=(path, *files),
        weight=GRAVITY * model.mass,
        standing_height=height,
        lowest=_LOWEST * height,
        highest=_HIGHEST * height if made else 1e3,
        suspended_height=_SUSPENDED * height,
        reference_torque=float(table.get("reference_torque", typical)),
        **others,
    )


def _leg(name: str, table: Any, names: tuple[str, ...], pose: dict[str, float], model: UserModel, where: str) -> Leg:
    joints, phase = tuple(table["joints"]), float(table["phase"])
    if len(joints) != 3 or len(set(joints)) != 3 or not set(joints) <= set(names):
        raise ArtifactError(
            f"joints {list(joints)} are not three joints of the robot", where=where,
            remedy=f"give abduction, hip and knee, of {', '.join(names)}",
        )  # fmt: skip
    if not phase < 1.0:
        raise ArtifactError(f"phase {phase:g} is not in [0, 1)", where=where, remedy="give a share of the cycle")
    thigh, shank, radius, rest = model.leg_geometry(joints, table["foot"], pose)
    places = (names.index(joints[0]), names.index(joints[1]), names.index(joints[2]))
    return Leg(name, places, table["foot"], phase, thigh, shank, radius, rest)


def _require_own(legs: dict[str, Any], where: str) -> None:
    """Refuse two legs that share a joint or a foot."""
    for what, used in (
        ("joint", [joint for leg in legs.values() for joint in leg["joints"]]),
        ("foot", [leg["foot"] for leg in legs.values()]),
    ):
        for one in used:
            if used.count(one) > 1:
                raise ArtifactError(f"{what} {one!r} is in two legs", where=where, remedy="give every leg its own")


def _require_clocks(clocks: dict[str, float], where: str) -> None:
    for key in ("physics_dt", "twin_physics_dt"):
        steps = clocks["control_dt"] / clocks[key]
        if steps < 1.0 - 1e-6 or abs(steps - round(steps)) > 1e-6:
            raise ArtifactError(
                f"{key} {clocks[key]:g} s does not divide control_dt {clocks['control_dt']:g} s", where=where,
                remedy="give a step that does",
            )  # fmt: skip


def _loads(value: list[float], where: str) -> tuple[float, float]:
    if len(value) != 2 or value[0] > value[1]:
        raise ArtifactError(f"load_inertia {value} is no range", where=where, remedy="write [least, most] in kg·m²")
    return float(value[0]), float(value[1])


def _gait(table: Any, legs: tuple[Leg, ...], pose: tuple[float, ...], where: str) -> Gait | None:
    """That of the robot's size but for what the table says; None without legs."""
    _GAIT.check(table, where)
    if not legs:
        return None
    usual = Gait.of_size(float(np.mean([leg.drop(np.array(pose)) for leg in legs])))
    forward = tuple(map(float, table.get("forward", usual.forward)))
    if len(forward) != 2 or not forward[0] <= 0.0 < forward[1]:
        raise ArtifactError(
            f"forward {list(forward)} m/s is not two speeds with standing still between them", where=where,
            remedy="give the fastest speed backward, 0 or negative, then the fastest forward",
        )  # fmt: skip
    numbers = {key: float(value) for key, value in table.items() if key != "forward"}
    return replace(usual, forward=(forward[0], forward[1]), **numbers)


def _require_bounds(
    numbers: dict[str, tuple[float, ...]], names: tuple[str, ...], bounds: list[tuple[float, float]], where: str
) -> None:
    """Refuse gains and torque limits that are not positive, and a pose beyond the joints' limits."""
    for key in ("kp", "kd", "torque_limit"):
        for name, value in zip(names, numbers[key], strict=True):
            if value < 0.0 or (value == 0.0 and key != "kd"):
                bound = "below 0" if key == "kd" else "not above 0"
                raise ArtifactError(f"{key} {value:g} of joint {name!r} is {bound}", where=where, remedy="correct it")
    for name, value, (lower, upper) in zip(names, numbers["nominal_pose"], bounds, strict=True):
        if not lower <= value <= upper:
            raise ArtifactError(
                f"nominal_pose {value:g} rad of joint {name!r} is outside its limits {lower:g} to {upper:g} rad",
                where=where, remedy="give an angle within the limits of the model",
            )  # fmt: skip


def _numbers(key: str, value: Any, count: int, per_leg: int, where: str) -> tuple[float, ...]:
    """One number per joint, from a number, one per joint of a leg, or one per joint."""
    values = value if isinstance(value, list) else [value]
    made = tuple(map(float, values))
    if len(made) not in (1, per_leg, count):
        forms = sorted({1, per_leg, count})
        remedy = f"give {' or '.join(map(str, forms))} numbers"
        raise ArtifactError(f"{key} has {len(made)} numbers", where=where, remedy=remedy)
    return made * (count // len(made))
