"""Loads of the motors of a robot with suspended or fixed base, by inverse dynamics of one joint.

With the base fixed, M(q)·q̈ + b(q, q̇) = τ, where M has the links' inertia only (a rotor's belongs
to its motor) and b the gravity and Coriolis torques. For joint j this has the form of a bench with
the known loads of a `MotorLog`:

    J_j·q̈_j = τ_j + (-b_j - Σ_{k≠j} M_jk·q̈_k - (M_jj - J_j)·q̈_j)
    load_inertia     external_torque

With the base at roll r and pitch p (`MotorLog.base_orientation`), gravity in the frame of the base
is g·(sin p, -sin r·cos p, -cos r·cos p). A base without a logged orientation is level.

J_j is the mean of M_jj over the segment, since the inertia of a bench is constant. A simulated
joint soon leaves the recorded angle, so the change of gravity with the joint's own angle is needed
too. With hinge axis a, mass m of the links beyond the joint and r to their centre of mass, the
gravity torque is a·(r × m·g), and

    load_stiffness = ∂(torque of gravity)/∂q_j = a·((a × r) × m·g);  0 for a slide

joint_torque stays: `torque_use` decides whether a fit can use it. The loads have the errors of the
encoders, which differ from the joints by backlash, twist and zero offset.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.loads_bodies import bodies_of
from motorprior.logs.loads_dynamics import BodyDynamics, make_inertia_constant
from motorprior.logs.motor_log import BASE_AXES, POSTURES, MotorLog, checked
from motorprior.robots.robot import Robot

LOADS = ("load_inertia", "external_torque", "load_stiffness")
MAX_SWAY = 0.15  # maximum deviation of roll and pitch from their medians in 90 % of the rows [rad]


@dataclass(frozen=True)
class LoadSource:
    """Where the loads of a log come from: its own channels, the robot's model, or nowhere."""

    name: Literal["log", "model", "unknown"]
    reason: str  # for the user

    def __str__(self) -> str:
        return f"loads: {self.reason}"


def load_source(
    log: MotorLog, robot: Robot | None, suspended: bool, where: str | Path
) -> LoadSource:
    """Decide which loads a log gets, and why.

    Logged loads stay. Otherwise the model of the robot gives them if its base does not move: a
    fixed base, a base that the user states to be suspended, or the logged posture "suspended" in
    every row. The log then needs all joints of the robot in their order, and a base that does not
    sway.

    Raises:
        ConfigError: ``suspended`` without a robot, or for a log that has loads.
        LogError: ``suspended``, and the log lacks joints, sways or has another posture.
    """
    logged = [name for name in LOADS if getattr(log, name) is not None]
    if suspended and logged:
        raise ConfigError(
            f"suspended: the log already contains its load ({logged[0]})",
            where=where,
            remedy="remove suspended",
            argument="suspended",
        )
    if logged:
        return LoadSource("log", "from the log")

    if robot is None:
        if suspended:
            raise ConfigError(
                "suspended: no model for the loads",
                where=where,
                remedy="give robot, its .toml file (docs/your-robot.md)",
                argument="robot",
            )
        return LoadSource("unknown", "unknown, no robot is given")

    if suspended:
        require_posture(log, robot, where)
    elif robot.base == "free" and not _is_suspended(log):
        postures = ", ".join(_logged_postures(log))
        remedy = "set suspended if it was suspended"
        return LoadSource("unknown", f"unknown, posture of {robot.name}: {postures} ({remedy})")

    try:
        _require_fixed_robot(log, robot)
    except LogError as error:
        if suspended:
            raise
        return LoadSource("unknown", f"unknown, {error.problem}")
    return LoadSource("model", f"rigid bodies of {robot.name}, base fixed")


def _is_suspended(log: MotorLog) -> bool:
    return _logged_postures(log) == ["suspended"]


def _logged_postures(log: MotorLog) -> list[str]:
    """Sorted names of the postures of a log's rows."""
    if log.posture is None:
        return ["unknown"]
    return sorted(POSTURES[code] for code in np.unique(log.posture).tolist())


def _posture(robot: Robot) -> str:
    """Posture in which the base does not move."""
    return "suspended" if robot.base == "free" else "fixed"


def require_posture(log: MotorLog, robot: Robot, where: str | Path) -> None:
    """Raise LogError if the log has rows of a posture in which the robot's base may move."""
    if log.posture is None:
        return
    posture = _posture(robot)
    rows = np.flatnonzero(log.posture != POSTURES.index(posture))
    if not rows.size:
        return
    logged = POSTURES[log.posture[rows[0]]]
    raise LogError(
        f"row {rows[0]} has the posture {logged}; loads need {posture} in every row",
        where=where,
        remedy="correct the posture, cut those rows from the file, or import without suspended",
        argument="suspended",
    )


def _require_fixed_robot(log: MotorLog, robot: Robot) -> None:
    """Raise LogError unless the log has all joints of the robot in its order and a fixed base.

    The load of each joint depends on the motion of all joints.
    """
    if log.joint_names != robot.joint_names:
        problem = f"joints in the order {', '.join(log.joint_names)}"
        missing = [name for name in robot.joint_names if name not in log.joint_names]
        if missing:
            count = f"{len(missing)} of the {robot.num_joints} joints of {robot.name}"
            problem = f"it lacks {', '.join(missing)}: {count}"
        order = f"in the order {', '.join(robot.joint_names)}"
        raise LogError(
            problem,
            where=log.source,
            remedy="loads come from the motion of all joints: record all, or give the file of a "
            f"robot that has only these, {order}",
        )

    require_posture(log, robot, log.source)

    if log.base_orientation is None:
        return
    deviations = np.abs(log.base_orientation - np.median(log.base_orientation, axis=0))
    for axis, sway in zip(BASE_AXES, np.quantile(deviations, 0.9, axis=0), strict=True):
        if sway > MAX_SWAY:
            raise LogError(
                f"{axis} of the base sways by {sway:.2f} rad in 10 % of the rows",
                where=log.source,
                remedy="fix the body, or suspend it from more than one rope, so that it moves by "
                f"less than {MAX_SWAY:g} rad, and record again",
            )


def with_loads(log: MotorLog, robot: Robot) -> MotorLog:
    """The log with loads by the robot's model, and its posture.

    The loads are load_inertia [kg·m²], external_torque [N·m] and load_stiffness [N·m/rad].
    Accelerations are derivatives of joint_vel, which should be smooth: see
    `operations.smooth_on_grid`.

    Raises:
        LogError: not the joints of this robot, no velocities, or a base that was not fixed.
    """
    _require_fixed_robot(log, robot)
    if log.joint_vel is None:
        raise LogError(
            "no velocities, and loads need accelerations",
            where=log.source,
            remedy="load it with a period, which computes them from the angles",
        )

    model = _fixed_model(robot)
    dynamics = BodyDynamics(model, range(robot.num_joints))
    segments = log.segment_slices()
    loads = dynamics.loads(log, segments, log.joint_pos)
    for segment in segments:
        make_inertia_constant(log, [segment], loads)
    inertia, external, stiffness = loads
    return checked(
        replace(
            log,
            load_inertia=inertia,
            external_torque=external,
            load_stiffness=stiffness,
            bodies=bodies_of(model),
            posture=np.full(log.num_rows, POSTURES.index(_posture(robot))),
        )
    )


def with_torque_balance(log: MotorLog, robot: Robot) -> MotorLog:
    """The log of a robot in any posture with loads that balance its joint_torque.

    external_torque = load_inertia·q̈ - joint_torque [N·m], where load_inertia [kg·m²] is the joint's
    own element of the mass matrix at the median angles.

    Raises:
        LogError: no joint_torque, no velocities, or other joints.
    """
    if log.joint_torque is None or log.joint_vel is None or log.joint_names != robot.joint_names:
        raise LogError(
            "no torques, no velocities, or not the joints of the robot",
            where=log.source,
            remedy="give the log of a robot that records currents",
        )

    at_rest = np.zeros(log.num_joints)
    dynamics = BodyDynamics(_fixed_model(robot), range(robot.num_joints))
    inertia, _ = dynamics.load(np.median(log.joint_pos, axis=0), at_rest, at_rest)

    external = np.empty_like(log.joint_pos)
    for segment in log.segment_slices():
        acceleration = np.gradient(log.joint_vel[segment], log.time[segment], axis=0)
        external[segment] = inertia * acceleration - log.joint_torque[segment]

    rows_of_inertia = np.tile(inertia, (log.num_rows, 1))
    return checked(replace(log, load_inertia=rows_of_inertia, external_torque=external, bodies=""))


def with_placeholder_load(log: MotorLog) -> MotorLog:
    """The log, with a placeholder load if it has none: responses do not read it."""
    if log.external_torque is not None and log.load_inertia is not None:
        return log
    return replace(
        log,
        external_torque=np.zeros_like(log.joint_pos),
        load_inertia=np.ones_like(log.joint_pos),
    )


def gravity_torque(log: MotorLog, robot: Robot) -> Callable[[np.ndarray], np.ndarray] | None:
    """Torque of gravity on the joints (N, J) [N·m] at angles (N, J) [rad], by the robot's model.

    None if the log has other joints, its base was not fixed, or a free base has no logged posture.
    """
    try:
        _require_fixed_robot(log, robot)
    except LogError:
        return None
    if robot.base == "free" and log.posture is None:
        return None

    dynamics = BodyDynamics(_fixed_model(robot), range(robot.num_joints))
    dynamics.set_gravity(np.median(dynamics.gravity_of(log), axis=0))

    def torque(angles: np.ndarray) -> np.ndarray:
        return np.stack([dynamics.gravity_torque(pose) for pose in angles])

    return torque


def _fixed_model(robot: Robot) -> Any:
    """Compiled model of a robot whose base is fixed."""
    from motorprior.robots.build_model import build_model

    return build_model(robot, suspended=robot.base == "free")
