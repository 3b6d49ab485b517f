"""A robot by name, or from a user's TOML beside his MJCF or URDF.

    name = "go2"                     # short; priors, policies and logs carry it
    motor = "GO-M8010-6"             # name of the motors
    model = "go2.xml"                # MJCF or URDF beside this file
    actuators = "remove"             # take the model's own actuators out; without it they are refused
    base = "free"                    # or "fixed"
    nominal_pose = [0.0, 0.9, -1.8]  # [rad]: a number, one per joint of a leg, or one per joint
    kp = 25.0                        # [N·m/rad] and
    kd = 0.5                         # [N·m·s/rad] at the joint: the same three forms
    torque_limit = 23.7              # [N·m]
    encoder = "joint"                # or "rotor"

    [legs.FR]                        # none for an arm
    joints = ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"]   # abduction, hip, knee
    foot = "FR"                      # a geom
    phase = 0.0                      # in the cycle of a trot

Everything else has a default: `joints` (all hinges of the model), `foot_friction`, `physics_dt`, `control_dt`,
`twin_physics_dt`, `reference_torque`, and a table `[gait]` with the fields of `Gait`.
"""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

from motorprior.exceptions import ArtifactError
from motorprior.robots.model import ModelFile
from motorprior.robots.robot import Gait, Joint, Leg, Robot
from motorprior.robots.shipped import SHIPPED
from motorprior.robots.user_model import UserModel

_NEEDED = {"name", "motor", "model", "base", "nominal_pose", "kp", "kd", "torque_limit"}
_CLOCKS = {"physics_dt": 0.002, "control_dt": 0.01, "twin_physics_dt": 0.001}
_OPTIONAL = {"encoder", "actuators", "joints", "legs", "gait", "foot_friction", "reference_torque", *_CLOCKS}
_LEG = {"joints", "foot", "phase"}
_USUAL_LOAD = 0.8
"""Of the torque limit: the reference torque where none is given."""
_LOWEST, _HIGHEST, _HUNG = 0.3, 3.5, 2.0
"""Heights of a fallen, a failed and a hung robot's base, in standing heights."""


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
    return _from_table(_read(path), path)


def as_robot(robot: Robot | str | Path) -> Robot:
    """The robot itself, or `load_robot` of its name or path."""
    return robot if isinstance(robot, Robot) else load_robot(robot)


def _read(path: Path) -> dict[str, Any]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ArtifactError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error
    except (ValueError, RecursionError) as error:
        raise ArtifactError(f"not valid TOML ({error})", where=path, remedy="see docs/your-robot.md") from error
    _require_keys(table, _NEEDED, _OPTIONAL, str(path))
    return table


def _require_keys(table: Any, needed: set[str], optional: set[str], where: str) -> None:
    if not isinstance(table, dict):
        raise ArtifactError("not a table", where=where, remedy="see docs/your-robot.md")
    unknown, missing = sorted(table.keys() - needed - optional), sorted(needed - table.keys())
    if unknown or missing:
        parts = [f"unknown keys {unknown}"] if unknown else []
        parts += [f"missing keys {missing}"] if missing else []
        known = ", ".join(sorted(needed | optional))
        raise ArtifactError(" and ".join(parts), where=where, remedy=f"the keys are {known}")


def _from_table(table: dict[str, Any], path: Path) -> Robot:
    where = str(path)
    for key in ("name", "motor", "model"):
        _require_text(key, table[key], where)
    base = _choice("base", table["base"], ("free", "fixed"), where)
    encoder = _choice("encoder", table.get("encoder", "joint"), ("joint", "rotor"), where)
    removes = "actuators" in table and _choice("actuators", table["actuators"], ("remove",), where) == "remove"
    file = path.parent / table["model"]
    legs = table.get("legs", {})
    if not isinstance(legs, dict):
        raise ArtifactError("legs is not a table of tables", where=where, remedy="write one table [legs.NAME] per leg")
    model = UserModel(file, base == "free", removes)
    names = model.joint_names(_texts("joints", table["joints"], where) if "joints" in table else None)
    bounds = [model.limits(name) for name in names]
    per_leg = len(names) // max(1, len(legs))
    numbers = {
        key: _numbers(key, table[key], len(names), per_leg, where)
        for key in ("nominal_pose", "kp", "kd", "torque_limit")
    }
    _require_bounds(numbers, names, bounds, where)
    joints = tuple(
        Joint(name, *bounds[i], numbers["kp"][i], numbers["kd"][i], numbers["torque_limit"][i], encoder)  # pyright: ignore[reportArgumentType]
        for i, name in enumerate(names)
    )
    pose = dict(zip(names, numbers["nominal_pose"], strict=True))
    made = tuple(_leg(name, leg, names, pose, model, f"{where}[legs.{name}]") for name, leg in legs.items())
    height = model.standing_height(pose, [leg.foot for leg in made]) if made else 0.0
    others: dict[str, Any] = {
        key: _number(key, table.get(key, default), where) for key, default in ({"foot_friction": 0.6} | _CLOCKS).items()
    }
    typical = _USUAL_LOAD * sorted(numbers["torque_limit"])[len(names) // 2]
    return Robot(
        name=table["name"],
        motor=table["motor"],
        joints=joints,
        base=base,  # pyright: ignore[reportArgumentType]
        model=ModelFile(file.resolve(), hashlib.sha256(file.read_bytes()).hexdigest(), removes),
        num_links=model.num_links,
        nominal=numbers["nominal_pose"],
        legs=made,
        gait=_gait(table.get("gait", {}), f"{where}[gait]"),
        load_inertia=model.load_inertia(pose, len(made), height),
        files=(path, file),
        standing_height=height,
        lowest=_LOWEST * height,
        highest=_HIGHEST * height if made else 1e3,
        hung_height=_HUNG * height,
        reference_torque=_number("reference_torque", table.get("reference_torque", typical), where),
        **others,
    )


def _leg(name: str, table: Any, names: tuple[str, ...], pose: dict[str, float], model: UserModel, where: str) -> Leg:
    _require_keys(table, _LEG, set(), where)
    joints = _texts("joints", table["joints"], where)
    if len(joints) != 3 or not set(joints) <= set(names):
        raise ArtifactError(
            f"joints {list(joints)} are not three joints of the robot", where=where,
            remedy=f"give abduction, hip and knee, of {', '.join(names)}",
        )  # fmt: skip
    _require_text("foot", table["foot"], where)
    phase = _number("phase", table["phase"], where, least=0.0)
    if not phase < 1.0:
        raise ArtifactError(f"phase {phase:g} is not in [0, 1)", where=where, remedy="give a share of the cycle")
    thigh, shank, radius = model.leg_lengths(joints, table["foot"], pose)
    places = (names.index(joints[0]), names.index(joints[1]), names.index(joints[2]))
    return Leg(name, places, table["foot"], phase, thigh, shank, radius)


def _gait(table: Any, where: str) -> Gait:
    known = {field.name for field in fields(Gait)}
    _require_keys(table, set(), known, where)
    return Gait(**{key: _number(key, value, where, least=-10.0) for key, value in table.items()})


def _require_bounds(
    numbers: dict[str, tuple[float, ...]], names: tuple[str, ...], bounds: list[tuple[float, float]], where: str
) -> None:
    """Refuse gains and torque limits that are not positive, and a pose beyond the joints' limits."""
    for key in ("kp", "kd", "torque_limit"):
        for name, value in zip(names, numbers[key], strict=True):
            if value < 0.0 or (value == 0.0 and key != "kd"):
                raise ArtifactError(
                    f"{key} {value:g} of joint {name!r} is not above 0", where=where, remedy="correct it"
                )
    for name, value, (lower, upper) in zip(names, numbers["nominal_pose"], bounds, strict=True):
        if not lower <= value <= upper:
            raise ArtifactError(
                f"nominal_pose {value:g} rad of joint {name!r} is outside its limits {lower:g} to {upper:g} rad",
                where=where, remedy="give an angle within the limits of the model",
            )  # fmt: skip


def _numbers(key: str, value: Any, count: int, per_leg: int, where: str) -> tuple[float, ...]:
    """One number per joint, from a number, one per joint of a leg, or one per joint."""
    values = value if isinstance(value, list) else [value]
    made = tuple(_number(key, each, where, least=-1e9) for each in values)
    if len(made) not in (1, per_leg, count):
        forms = sorted({1, per_leg, count})
        raise ArtifactError(f"{key} has {len(made)} numbers", where=where, remedy=f"give {forms} numbers")
    return made * (count // len(made))


def _number(key: str, value: Any, where: str, least: float = 1e-9) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= 1e9:
        raise ArtifactError(
            f"{key} = {str(value)[:40]!r} is not a number of at least {least:g}", where=where, remedy="correct it"
        )
    return float(value)


def _choice(key: str, value: Any, known: tuple[str, ...], where: str) -> str:
    if value not in known:
        raise ArtifactError(f"{key} = {str(value)[:40]!r} is unknown", where=where, remedy=f"use one of {known}")
    return value


def _require_text(key: str, value: Any, where: str) -> None:
    if not isinstance(value, str) or not value:
        raise ArtifactError(f"{key} = {str(value)[:40]!r} is not a text", where=where, remedy="write it in quotes")


def _texts(key: str, value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not value or not all(isinstance(each, str) for each in value):
        raise ArtifactError(f"{key} is not a list of names", where=where, remedy='write ["first", "second"]')
    return tuple(value)
