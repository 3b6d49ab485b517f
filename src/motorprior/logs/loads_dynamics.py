"""Loads of the motors of a robot whose base is fixed, by its rigid bodies.

`loads` has the formulas.
"""

# MuJoCo is imported where it is used, since a robot's own computer has none.
from collections.abc import Sequence
from typing import Any

import numpy as np

from motorprior.logs.motor_log import MotorLog


class BodyDynamics:
    """Inverse dynamics of compiled bodies.

    ``order`` has the index in the model of each joint of a log.
    """

    def __init__(self, model: Any, order: Sequence[int]):
        import mujoco

        self._mujoco: Any = mujoco
        self._model = model
        self._order = np.array(order)
        self._data = mujoco.MjData(model)
        self._units = np.eye(model.nv)
        self._level_gravity = np.array(model.opt.gravity)

    def gravity_of(self, log: MotorLog) -> np.ndarray:
        """(T, 3) gravity in the frame of the base in every row [m/s²]."""
        if log.base_orientation is None:
            return np.tile(self._level_gravity, (log.num_rows, 1))
        return gravity_in_base(log.base_orientation, float(np.linalg.norm(self._level_gravity)))

    def set_gravity(self, gravity: np.ndarray) -> None:
        """Set the gravity (3,) in the frame of the base [m/s²]."""
        self._model.opt.gravity[:] = gravity

    def loads(self, log: MotorLog, segments: Sequence[slice], joint_pos: np.ndarray) -> np.ndarray:
        """(3, T, J) load inertia, external torque and load stiffness at angles (T, J).

        Velocities, accelerations and the orientation of the base are the log's. Rows outside of
        the segments have 0.
        """
        assert log.joint_vel is not None
        loads = np.zeros((3, log.num_rows, log.num_joints))
        gravity = self.gravity_of(log)
        axis = np.empty((*joint_pos.shape, 3))
        arm = np.empty((*joint_pos.shape, 3))
        for segment in segments:
            acceleration = np.gradient(log.joint_vel[segment], log.time[segment], axis=0)
            rows = range(log.num_rows)[segment]
            for row, joint_acc in zip(rows, acceleration, strict=True):
                self.set_gravity(gravity[row])
                loads[0, row], loads[1, row] = self.load(
                    joint_pos[row], log.joint_vel[row], joint_acc
                )
                axis[row] = self._data.xaxis[self._order]
                arm[row] = self._arms()
            loads[2, segment] = self._gravity_stiffness(
                axis[segment], arm[segment], gravity[segment]
            )
        return loads

    def load(
        self, joint_pos: np.ndarray, joint_vel: np.ndarray, joint_acc: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Load inertia (J,) [kg·m²] and external torque (J,) [N·m] in one state."""
        bias = self.bias(joint_pos, joint_vel)
        column = np.zeros(self._model.nv)
        inertia = np.zeros(self._model.nv)
        for joint, unit in enumerate(self._units):
            self._mujoco.mj_mulM(self._model, self._data, column, unit)
            inertia[joint] = column[joint]
        own_inertia = inertia[self._order]

        # torque of all accelerations, without the joint's own
        accelerations = np.zeros(self._model.nv)
        accelerations[self._order] = joint_acc
        self._mujoco.mj_mulM(self._model, self._data, column, accelerations)
        external = -bias - (column[self._order] - own_inertia * joint_acc)
        return own_inertia, external

    def bias(self, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """(J,) torque against gravity and Coriolis torques [N·m]; the state stays set."""
        self._data.qpos[self._order] = joint_pos
        self._data.qvel[self._order] = joint_vel
        self._mujoco.mj_fwdPosition(self._model, self._data)
        self._mujoco.mj_fwdVelocity(self._model, self._data)
        return self._data.qfrc_bias[self._order]

    def gravity_torque(self, joint_pos: np.ndarray) -> np.ndarray:
        """(J,) torque of gravity at rest [N·m]; the state stays set."""
        return -self.bias(joint_pos, np.zeros_like(joint_pos))

    def _arms(self) -> np.ndarray:
        """(J, 3) from each joint to the centre of mass of what it carries [m]."""
        arms = self._data.subtree_com[self._model.jnt_bodyid] - self._data.xanchor
        return arms[self._order]

    def _gravity_stiffness(
        self, axis: np.ndarray, arm: np.ndarray, gravity: np.ndarray
    ) -> np.ndarray:
        """(T, J) load_stiffness [N·m/rad] at axes and arms (T, J, 3), gravity (T, 3)."""
        mass = self._model.body_subtreemass[self._model.jnt_bodyid[self._order]]
        weight = mass[:, None] * gravity[:, None]
        joint_type = self._model.jnt_type[self._order]
        is_hinge = joint_type == self._mujoco.mjtJoint.mjJNT_HINGE
        torque = np.cross(np.cross(axis, arm), weight)
        return np.where(is_hinge, np.einsum("tji,tji->tj", axis, torque), 0.0)


def gravity_in_base(orientation: np.ndarray, magnitude: float) -> np.ndarray:
    """(…, 3) gravity in the frame of a base with roll and pitch (…, 2) [rad]."""
    roll, pitch = np.moveaxis(orientation, -1, 0)
    down = [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]
    return magnitude * np.stack(down, axis=-1)


def make_inertia_constant(log: MotorLog, segments: Sequence[slice], loads: np.ndarray) -> None:
    """Change loads (3, T, J, …) of each row in place, so that they are as a log has them.

    The inertia becomes the mean over the segments. The rest of the inertia's torque is added to the
    external torque, which becomes the mean to the next row.
    """
    assert log.joint_vel is not None
    inertia, external, _ = loads
    mean_inertia = np.concatenate([inertia[segment] for segment in segments]).mean(axis=0)
    missing_axes = tuple(range(2, external.ndim))
    for segment in segments:
        acceleration = np.gradient(log.joint_vel[segment], log.time[segment], axis=0)
        acceleration = np.expand_dims(acceleration, missing_axes)
        external[segment] -= (inertia[segment] - mean_inertia) * acceleration
        external[segment][:-1] = 0.5 * (external[segment][:-1] + external[segment][1:])
        inertia[segment] = mean_inertia
