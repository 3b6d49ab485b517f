"""Loads of the motors of a robot with suspended or fixed base, by inverse dynamics, one joint at a time.

With the base fixed, M(q)·q̈ + b(q, q̇) = τ, where M has the links' inertia only (a rotor's belongs to its motor) and b
the gravity and Coriolis torques. For joint j this has the form of a bench with the known loads of a `MotorLog`:

    J_j·q̈_j = τ_j + (-b_j - Σ_{k≠j} M_jk·q̈_k - (M_jj - J_j)·q̈_j)
    load_inertia     external_torque

J_j is the mean of M_jj over the segment, since the inertia of a bench is constant. A simulated joint soon leaves the
recorded angle, so the change of gravity with the joint's own angle is needed too. With hinge axis a, mass m of the
links beyond the joint and r to their centre of mass, the gravity torque is a·(r × m·g), and

    load_stiffness = ∂(torque of gravity)/∂q_j = a·((a × r) × m·g);  0 for a slide

joint_torque is dropped: a torque from the motor's current differs from the torque on the joint by rotor and gear
friction. The loads have the errors of the encoders, which differ from the joints by backlash, twist and zero offset.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.motor_log import BASE_AXES, POSTURES, MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot
from motorprior.simulation.build_model import build_model

MAX_TILT = 0.15  # [rad] median roll or pitch of a level body


def with_loads(log: MotorLog, robot: Robot) -> MotorLog:
    """The log with load_inertia [kg·m²], external_torque [N·m], load_stiffness [N·m/rad] and posture.

    Accelerations are derivatives of joint_vel, which should be smooth: see `read_robot_run` with a period.

    Raises:
        LogError: not the joints of this robot, no velocities, or a base that was not level or not fixed.
    """
    _require_joints(log, robot)
    require_fixed_base(log, robot, log.source)
    if log.joint_vel is None:
        remedy = "import it with a period, which computes them from the angles"
        raise LogError("no velocities, and loads need accelerations", where=log.source, remedy=remedy)
    _require_level(log)
    model = build_model(robot, suspended=robot.base == "free")
    data = mujoco.MjData(model)
    inertia, external, stiffness = (np.empty_like(log.joint_pos) for _ in range(3))
    for part in log.segment_slices():
        acceleration = np.gradient(log.joint_vel[part], log.time[part], axis=0)
        for row, joint_acc in zip(range(part.start, part.stop), acceleration, strict=True):
            inertia[row], external[row] = _load(model, data, log.joint_pos[row], log.joint_vel[row], joint_acc)
            stiffness[row] = _gravity_stiffness(model, data)
        mean = inertia[part].mean(axis=0)
        external[part] -= (inertia[part] - mean) * acceleration
        external[part][:-1] = 0.5 * (external[part][:-1] + external[part][1:])  # a log has the mean to the next row
        inertia[part] = mean
    posture = np.full(log.num_rows, POSTURES.index(_posture(robot)))
    loads = {"load_inertia": inertia, "external_torque": external, "load_stiffness": stiffness}
    return checked(replace(log, **loads, joint_torque=None, posture=posture), where=log.source)


def gravity_torque(log: MotorLog, robot: Robot) -> Callable[[np.ndarray], np.ndarray] | None:
    """Torque of gravity on the joints (N, J) [N·m] at angles (N, J) [rad], by the robot's model.

    None if the log has other joints, its base was not level and fixed, or a free base has no logged posture.
    """
    try:
        _require_joints(log, robot)
        require_fixed_base(log, robot, log.source)
        _require_level(log)
    except LogError:
        return None
    if robot.base == "free" and log.posture is None:
        return None
    model = build_model(robot, suspended=robot.base == "free")
    data, at_rest = mujoco.MjData(model), np.zeros(model.nv)
    return lambda angles: np.stack([-_bias(model, data, pose, at_rest) for pose in angles])


def _posture(robot: Robot) -> str:
    return "suspended" if robot.base == "free" else "fixed"


def require_fixed_base(log: MotorLog, robot: Robot, where: str | Path, option: str = "") -> None:
    """Reject a log with a posture other than suspended (of a free base) or fixed (of a fixed base) in any row.

    Args:
        log: may have no posture.
        robot: of the log.
        where: file of the log.
        option: setting by which the user gives such a posture.

    Raises:
        LogError: another posture; ConfigError, which names the argument, if ``option`` is given.
    """
    wanted = _posture(robot)
    if log.posture is None or not (others := np.flatnonzero(log.posture != POSTURES.index(wanted))).size:
        return
    problem = (
        f"row {others[0]} states the posture {POSTURES[log.posture[others[0]]]}, and {robot.name}, whose base is "
        f"{robot.base}, has to be {wanted} in every row"
    )
    remedy = "correct the posture, or cut those rows from the file"
    if option:
        raise ConfigError(f"{option}: {problem}", where=where, remedy=f"leave {option} out, {remedy}", argument=option)
    raise LogError(problem, where=where, remedy=remedy)


def _require_joints(log: MotorLog, robot: Robot) -> None:
    """Reject a log that does not have all joints of the robot in its order: the load of each depends on all."""
    missing = [name for name in robot.joint_names if name not in log.joint_names]
    unknown = [name for name in log.joint_names if name not in robot.joint_names]
    if missing:
        problem = f"it lacks {', '.join(missing)}: {len(missing)} of the {robot.num_joints} joints of {robot.name}"
        if unknown:
            problem += f", and has {', '.join(unknown)}"
        remedy = "loads come from the motion of all joints: record all, or give the file of a robot that has only these"
    elif unknown:
        problem, remedy = f"{robot.name} has no joint {', '.join(unknown)}", "give the robot that was recorded"
    elif log.joint_names != robot.joint_names:
        problem = f"joints in the order {', '.join(log.joint_names)}"
        remedy = f"give them in the order of {robot.name}: {', '.join(robot.joint_names)}"
    else:
        return
    raise LogError(problem, where=log.source, remedy=remedy)


def _require_level(log: MotorLog) -> None:
    if log.base_orientation is None:
        return
    tilt = np.median(np.abs(log.base_orientation), axis=0)
    for axis, angle in zip(BASE_AXES, tilt, strict=True):
        if angle > MAX_TILT:
            raise LogError(
                f"{axis} is {angle:.2f} rad off level, by its median", where=log.source,
                remedy=f"hang the robot up with its body level, to {MAX_TILT:g} rad, and record again",
            )  # fmt: skip


def _load(model, data, joint_pos: np.ndarray, joint_vel: np.ndarray, joint_acc: np.ndarray) -> tuple:
    """(joints,) load inertia and (joints,) external torque in one state."""
    bias = _bias(model, data, joint_pos, joint_vel)
    own, inertial, column = np.zeros(model.nv), np.zeros(model.nv), np.zeros(model.nv)
    for joint, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        own[joint] = column[joint]
    mujoco.mj_mulM(model, data, inertial, joint_acc)
    return own, -bias - (inertial - own * joint_acc)


def _bias(model, data, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
    """(joints,) torque against gravity and Coriolis torques [N·m]; leaves this state in ``data``."""
    data.qpos[:], data.qvel[:] = joint_pos, joint_vel
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    return data.qfrc_bias.copy()


def _gravity_stiffness(model, data) -> np.ndarray:
    """(joints,) load_stiffness [N·m/rad], in the state that `_load` has set."""
    axis, body = data.xaxis, model.jnt_bodyid
    weight = model.body_subtreemass[body][:, None] * model.opt.gravity
    sideways = np.cross(axis, data.subtree_com[body] - data.xanchor)
    hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    return np.where(hinge, np.einsum("ji,ji->j", axis, np.cross(sideways, weight)), 0.0)
