"""Loads of the motors of a robot with suspended or fixed base, by inverse dynamics, one joint at a time.

With the base fixed, M(q)·q̈ + b(q, q̇) = τ, where M has the links' inertia only (a rotor's belongs
to its motor) and b the gravity and Coriolis torques. For joint j this has the form of a bench with
the known loads of a `MotorLog`:

    J_j·q̈_j = τ_j + (-b_j - Σ_{k≠j} M_jk·q̈_k - (M_jj - J_j)·q̈_j)
    load_inertia     external_torque

J_j is the mean of M_jj over the segment, since the inertia of a bench is constant. A simulated
joint soon leaves the recorded angle, so the change of gravity with the joint's own angle is needed
too. With hinge axis a, mass m of the links beyond the joint and r to their centre of mass, the
gravity torque is a·(r × m·g), and

    load_stiffness = ∂(torque of gravity)/∂q_j = a·((a × r) × m·g);  0 for a slide

joint_torque is dropped: a torque from the motor's current differs from the torque on the joint by
rotor and gear friction. The loads have the errors of the encoders, which differ from the joints by
backlash, twist and zero offset.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs; it is imported where it is used, since a robot's own computer has
# none.
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import BASE_AXES, POSTURES, MotorLog, checked
from motorprior.robots.robot import Robot

LOADS = ("load_inertia", "external_torque", "load_stiffness")
MAX_TILT = 0.15  # [rad] median roll or pitch of a level body


def with_loads(log: MotorLog, robot: Robot) -> MotorLog:
    """The log with load_inertia [kg·m²], external_torque [N·m], load_stiffness [N·m/rad] and posture.

    Accelerations are derivatives of joint_vel, which should be smooth: see
    `operations.smooth_on_grid`.

    Raises:
        LogError: not the joints of this robot, no velocities, or a base that was not level or not
            fixed.
    """
    _require_level_robot(log, robot)
    if log.joint_vel is None:
        remedy = "load it with a period, which computes them from the angles"
        raise LogError(
            "no velocities, and loads need accelerations", where=log.source, remedy=remedy
        )
    dynamics = _Dynamics(robot)
    inertia, external, stiffness = (np.empty_like(log.joint_pos) for _ in range(3))
    axis, arm = np.empty((2, *log.joint_pos.shape, 3))
    for part in log.segment_slices():
        acceleration = np.gradient(log.joint_vel[part], log.time[part], axis=0)
        for row, joint_acc in zip(range(part.start, part.stop), acceleration, strict=True):
            found = dynamics.load(log.joint_pos[row], log.joint_vel[row], joint_acc)
            inertia[row], external[row], axis[row], arm[row] = found
        stiffness[part] = dynamics.gravity_stiffness(axis[part], arm[part])
        mean = inertia[part].mean(axis=0)
        external[part] -= (inertia[part] - mean) * acceleration
        # a log has the mean to the next row
        external[part][:-1] = 0.5 * (external[part][:-1] + external[part][1:])
        inertia[part] = mean
    posture = np.full(log.num_rows, POSTURES.index(_posture(robot)))
    loads = dict(zip(LOADS, (inertia, external, stiffness), strict=True))
    return checked(replace(log, **loads, joint_torque=None, posture=posture))


def with_torque_balance(log: MotorLog, robot: Robot) -> MotorLog:
    """The log of a robot in any posture with load_inertia [kg·m²] and external_torque [N·m], from its joint_torque.

    external_torque = load_inertia·q̈ - joint_torque, with load_inertia the joint's own element of
    the mass matrix at the median angles. Raises `LogError` without joint_torque or velocities, or
    for other joints.
    """
    if log.joint_torque is None or log.joint_vel is None or log.joint_names != robot.joint_names:
        problem = "no torques, no velocities, or not the joints of the robot"
        raise LogError(
            problem, where=log.source, remedy="give the log of a robot that records currents"
        )
    at_rest = np.zeros(log.num_joints)
    inertia = _Dynamics(robot).load(np.median(log.joint_pos, axis=0), at_rest, at_rest)[0]
    external = np.empty_like(log.joint_pos)
    for part in log.segment_slices():
        external[part] = (
            inertia * np.gradient(log.joint_vel[part], log.time[part], axis=0)
            - log.joint_torque[part]
        )
    return checked(
        replace(log, load_inertia=np.tile(inertia, (log.num_rows, 1)), external_torque=external)
    )


def with_placeholder_load(log: MotorLog) -> MotorLog:
    """The log, with a placeholder load if it has none: responses do not read it."""
    if log.external_torque is not None and log.load_inertia is not None:
        return log
    return replace(
        log, external_torque=np.zeros_like(log.joint_pos), load_inertia=np.ones_like(log.joint_pos)
    )


def gravity_torque(log: MotorLog, robot: Robot) -> Callable[[np.ndarray], np.ndarray] | None:
    """Torque of gravity on the joints (N, J) [N·m] at angles (N, J) [rad], by the robot's model.

    None if the log has other joints, its base was not level and fixed, or a free base has no logged
    posture.
    """
    try:
        _require_level_robot(log, robot)
    except LogError:
        return None
    if robot.base == "free" and log.posture is None:
        return None
    dynamics = _Dynamics(robot)
    at_rest = np.zeros(log.num_joints)
    return lambda angles: np.stack([-dynamics.bias(pose, at_rest) for pose in angles])


def _posture(robot: Robot) -> str:
    return "suspended" if robot.base == "free" else "fixed"


def require_fixed_base(log: MotorLog, robot: Robot, where: str | Path) -> None:
    """Raise LogError for a log, from the file ``where``, of another posture than suspended (free base) or fixed."""
    wanted = _posture(robot)
    if (
        log.posture is None
        or not (others := np.flatnonzero(log.posture != POSTURES.index(wanted))).size
    ):
        return
    problem = f"row {others[0]} has the posture {POSTURES[log.posture[others[0]]]}; loads need {wanted} in every row"
    remedy = "correct the posture, cut those rows from the file, or import without suspended"
    raise LogError(problem, where=where, remedy=remedy, argument="suspended")


def _require_level_robot(log: MotorLog, robot: Robot) -> None:
    """Reject a log without all joints of the robot in its order, since each load depends on all; or a tilted base."""
    if log.joint_names != robot.joint_names:
        problem = f"joints in the order {', '.join(log.joint_names)}"
        if missing := [name for name in robot.joint_names if name not in log.joint_names]:
            problem = f"it lacks {', '.join(missing)}: {len(missing)} of the {robot.num_joints} joints of {robot.name}"
        remedy = "loads come from the motion of all joints: record all, or give the file of a robot that has only "
        raise LogError(
            problem,
            where=log.source,
            remedy=f"{remedy}these, in the order {', '.join(robot.joint_names)}",
        )
    require_fixed_base(log, robot, log.source)
    orientation = np.zeros((1, 2)) if log.base_orientation is None else log.base_orientation
    for axis, angle in zip(BASE_AXES, np.median(np.abs(orientation), axis=0), strict=True):
        if angle > MAX_TILT:
            problem = f"{axis} is {angle:.2f} rad off level, by its median"
            remedy = f"suspend the robot with its body level, to {MAX_TILT:g} rad, and record again"
            raise LogError(problem, where=log.source, remedy=remedy)


class _Dynamics:
    """Rigid bodies of a robot whose base is fixed."""

    def __init__(self, robot: Robot):
        import mujoco

        from motorprior.robots.build_model import build_model

        self._mujoco: Any = mujoco
        self._model = build_model(robot, suspended=robot.base == "free")
        self._data, self._units = mujoco.MjData(self._model), np.eye(self._model.nv)

    def load(self, joint_pos: np.ndarray, joint_vel: np.ndarray, joint_acc: np.ndarray) -> tuple:
        """Load inertia [kg·m²], external torque [N·m], (joints, 3) axis [1] and arm [m] of each joint in one state.

        An arm goes from the joint to the centre of mass of what it carries.
        """
        bias, (own, column) = self.bias(joint_pos, joint_vel), np.zeros((2, self._model.nv))
        for joint, unit in enumerate(self._units):
            self._mujoco.mj_mulM(self._model, self._data, column, unit)
            own[joint] = column[joint]
        self._mujoco.mj_mulM(self._model, self._data, column, joint_acc)
        arm = self._data.subtree_com[self._model.jnt_bodyid] - self._data.xanchor
        return own, -bias - (column - own * joint_acc), self._data.xaxis, arm

    def bias(self, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """(joints,) torque against gravity and Coriolis torques [N·m]; the state stays set."""
        self._data.qpos[:] = joint_pos
        self._data.qvel[:] = joint_vel
        self._mujoco.mj_fwdPosition(self._model, self._data)
        self._mujoco.mj_fwdVelocity(self._model, self._data)
        return self._data.qfrc_bias.copy()

    def gravity_stiffness(self, axis: np.ndarray, arm: np.ndarray) -> np.ndarray:
        """(T, joints) load_stiffness [N·m/rad] at axes and arms (T, joints, 3)."""
        weight = (
            self._model.body_subtreemass[self._model.jnt_bodyid][:, None] * self._model.opt.gravity
        )
        hinge = self._model.jnt_type == self._mujoco.mjtJoint.mjJNT_HINGE
        return np.where(
            hinge, np.einsum("tji,tji->tj", axis, np.cross(np.cross(axis, arm), weight)), 0.0
        )
