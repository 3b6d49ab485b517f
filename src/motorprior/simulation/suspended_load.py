"""Loads of the motors of a suspended robot, by inverse dynamics, one joint at a time.

With the chassis fixed, M(q)·q̈ + b(q, q̇) = τ, where M has the links' inertia only (a rotor's own belongs to its motor)
and b gravity and Coriolis torques. For joint j this has the form of a bench with the known loads of a `MotorLog`:

    J_j·q̈_j = τ_j + (-b_j - Σ_{k≠j} M_jk·q̈_k - (M_jj - J_j)·q̈_j)
    load_inertia     external_torque

A torque computed from the motor's current is not the torque on the joint, because of the gear's friction and the rotor
(on the virtual robot 0.2 N·m where a knee gets 0.02), so it is left out; the equation gives the joint's torque.

A joint that is simulated is soon at another angle than the recorded one, where gravity pulls otherwise. Of what hangs
on a hinge with axis a, of mass m with its centre r away, the torque is a·(r × m·g). By the hinge's own angle it changes
by

    load_stiffness = ∂(torque of gravity)/∂q_j = a·((a × r) × m·g);  0 of a slide

J_j is the mean of M_jj over the segment, since the inertia of a bench is constant. The angles are those of the rotors'
encoders, which differ from the joints' by the gear's backlash and twist and by the encoder's zero; the loads have the
corresponding errors.
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

LEVEL = 0.15
"""Largest median roll or pitch of a body that counts as level [rad]; it shifts a seventh of gravity sideways."""


def with_loads(log: MotorLog, robot: Robot) -> MotorLog:
    """The same log with load_inertia, external_torque and load_stiffness for joint_torque, its body level and fixed.

    In kg·m², N·m and N·m/rad. Its posture says so. Accelerations are the derivative of joint_vel, so these should be
    smooth: see `read_robot_run` with a period.

    Raises:
        LogError: not the joints of this robot, without velocities, or of a robot that was not level, or not held.
    """
    _require_joints(log, robot)
    require_held(log, robot, log.source)
    if log.joint_vel is None:
        remedy = "import it with a period, and its angles say them"
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
        external[part][:-1] = 0.5 * (external[part][:-1] + external[part][1:])  # a log's are means until the next row
        inertia[part] = mean
    held = np.full(log.num_rows, POSTURES.index(held_posture(robot)))
    loads = {"load_inertia": inertia, "external_torque": external, "load_stiffness": stiffness}
    return checked(replace(log, **loads, joint_torque=None, posture=held), where=log.source)


def gravity_of_held(log: MotorLog, robot: Robot) -> Callable[[np.ndarray], np.ndarray] | None:
    """Torque of gravity on the joints (N, J) [N·m] at angles (N, J) [rad] of a robot that is held level, by its model.

    None where the log is not of this robot's joints, or of a base that was not held, or of a free one and does not say.
    """
    try:
        _require_joints(log, robot)
        require_held(log, robot, log.source)
        _require_level(log)
    except LogError:
        return None
    if robot.base == "free" and log.posture is None:
        return None
    model = build_model(robot, suspended=robot.base == "free")
    data, at_rest = mujoco.MjData(model), np.zeros(model.nv)
    return lambda angles: np.stack([-_bias(model, data, pose, at_rest) for pose in angles])


def held_posture(robot: Robot) -> str:
    """What a log calls it that the base of this robot is held."""
    return "suspended" if robot.base == "free" else "fixed"


def require_held(log: MotorLog, robot: Robot, where: str | Path, option: str = "") -> None:
    """Refuse a log that says, in any row, that the robot's base was not held.

    Args:
        log: may have no posture.
        robot: that it is of.
        where: file of the log.
        option: argument that says that it was.

    Raises:
        LogError: it was not.
        ConfigError: it was not, and an argument says that it was; names the argument.
    """
    held = held_posture(robot)
    if log.posture is None or not (odd := np.flatnonzero(log.posture != POSTURES.index(held))).size:
        return
    problem = (
        f"row {odd[0]} states the posture {POSTURES[log.posture[odd[0]]]}, and {robot.name}, whose base is "
        f"{robot.base}, has to be {held} in every row"
    )
    remedy = "correct the posture, or cut those rows from the file"
    if option:
        raise ConfigError(f"{option}: {problem}", where=where, remedy=f"leave {option} out, {remedy}", argument=option)
    raise LogError(problem, where=where, remedy=remedy)


def _require_joints(log: MotorLog, robot: Robot) -> None:
    """Refuse a log that is not of all joints of the robot, in its order: each carries the others."""
    missing = [name for name in robot.joint_names if name not in log.joint_names]
    strange = [name for name in log.joint_names if name not in robot.joint_names]
    if missing:
        problem = f"it lacks {', '.join(missing)}: {len(missing)} of the {robot.num_joints} joints of {robot.name}"
        if strange:
            problem += f", and has {', '.join(strange)}"
        remedy = "loads come from the motion of all joints: record all, or give the file of a robot that has only these"
    elif strange:
        problem, remedy = f"{robot.name} has no joint {', '.join(strange)}", "give the robot that was recorded"
    elif log.joint_names != robot.joint_names:
        problem = f"joints in the order {', '.join(log.joint_names)}"
        remedy = f"give them in the order of {robot.name}: {', '.join(robot.joint_names)}"
    else:
        return
    raise LogError(problem, where=log.source, remedy=remedy)


def _require_level(log: MotorLog) -> None:
    if log.base_orientation is None:
        return
    lean = np.median(np.abs(log.base_orientation), axis=0)
    for axis, angle in zip(BASE_AXES, lean, strict=True):
        if angle > LEVEL:
            raise LogError(
                f"{axis} is {angle:.2f} rad off level, by its median", where=log.source,
                remedy=f"hang the robot up with its body level, to {LEVEL:g} rad, and record again",
            )  # fmt: skip


def _load(model, data, joint_pos: np.ndarray, joint_vel: np.ndarray, joint_acc: np.ndarray) -> tuple:
    """(joints,) load inertia and (joints,) external torque at one moment."""
    bias = _bias(model, data, joint_pos, joint_vel)
    own, carried, column = np.zeros(model.nv), np.zeros(model.nv), np.zeros(model.nv)
    for joint, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        own[joint] = column[joint]
    mujoco.mj_mulM(model, data, carried, joint_acc)
    return own, -bias - (carried - own * joint_acc)


def _bias(model, data, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
    """(joints,) torque against gravity and Coriolis torques [N·m]; leaves these positions in ``data``."""
    data.qpos[:], data.qvel[:] = joint_pos, joint_vel
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    return data.qfrc_bias.copy()


def _gravity_stiffness(model, data) -> np.ndarray:
    """(joints,) change of gravity's torque with a hinge's own angle [N·m/rad], at the positions that `_load` set."""
    axis, body = data.xaxis, model.jnt_bodyid
    weight = model.body_subtreemass[body][:, None] * model.opt.gravity
    sideways = np.cross(axis, data.subtree_com[body] - data.xanchor)
    hinge = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
    return np.where(hinge, np.einsum("ji,ji->j", axis, np.cross(sideways, weight)), 0.0)
