"""One robot in MuJoCo: model, data, and the views of their memory that compiled code works on."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numba import njit

from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.actuator.torque_law import measure_joint_pos, reset_actuator, step_actuator
from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.mjcf import mjcf
from motorprior.simulation.mj_call import mj_step, mj_step_address

FAULTS = {1: "a joint or base coordinate is not finite", 2: "MuJoCo ran out of contact or constraint memory"}
"""Fault numbers of `BackendState` and what they mean."""


@dataclass(frozen=True)
class WorldConfig:
    """How the robot is simulated.

    Attributes:
        physics_dt: step [s]; must divide control_dt.
        control_dt: time a position target is held [s].
        foot_friction: sliding friction [-].
        hung: the chassis is fixed in the air.
    """

    physics_dt: float = spec.PHYSICS_DT
    control_dt: float = spec.CONTROL_DT
    foot_friction: float = spec.FOOT_FRICTION
    hung: bool = False

    @property
    def substeps(self) -> int:
        """Physics steps per control step.

        Raises:
            ConfigError: physics_dt does not divide control_dt.
        """
        count = round(self.control_dt / self.physics_dt)
        if count < 1 or abs(count * self.physics_dt - self.control_dt) > 1e-9:
            raise ConfigError(f"physics_dt {self.physics_dt} s does not divide control_dt {self.control_dt} s")
        return count


class WorldArrays(NamedTuple):
    """Addresses and views of one MjModel and MjData, for compiled code."""

    step: int
    model: int
    data: int
    qpos: np.ndarray
    qvel: np.ndarray
    applied: np.ndarray
    """(nv,) generalized force, the last 12 are the joints'"""
    damping: np.ndarray
    """(12,) the model's own implicit damping of the joints [N·m·s/rad], a view"""
    torque: np.ndarray
    """(12,) scratch"""
    physics_dt: float
    substeps: int


def _keep_quiet(message: str) -> None:
    """MuJoCo would write MUJOCO_LOG.TXT into the user's folder; faults are read from the state instead."""


class World:
    """A simulated Pupper. Use one per thread."""

    def __init__(self, config: WorldConfig):
        self.config = config
        mujoco.set_mju_user_warning(_keep_quiet)
        text = mjcf(physics_dt=config.physics_dt, foot_friction=config.foot_friction, hung=config.hung)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.first_joint = 0 if config.hung else 7
        self.first_dof = 0 if config.hung else 6
        self.arrays = WorldArrays(
            step=mj_step_address(),
            model=self.model._address,
            data=self.data._address,
            qpos=self.data.qpos,
            qvel=self.data.qvel,
            applied=self.data.qfrc_applied,
            damping=self.model.dof_damping[self.first_dof :],
            torque=np.zeros(spec.NUM_JOINTS),
            physics_dt=config.physics_dt,
            substeps=config.substeps,
        )

    def reset(self, actuator: Actuator, joint_pos: np.ndarray = spec.NOMINAL_POSE) -> ActuatorArrays:
        """Stand at ``joint_pos`` (12,) [rad], at rest, on these motors; returns the motors' fresh arrays."""
        mujoco.mj_resetData(self.model, self.data)
        self.model.dof_armature[self.first_dof :] = actuator.armature
        self.arrays.damping[:] = actuator.damping
        self.data.qpos[self.first_joint :] = joint_pos
        motors = actuator.arrays(self.config.physics_dt)
        reset_actuator(motors, np.ascontiguousarray(joint_pos), np.ascontiguousarray(joint_pos))
        return motors

    def fault(self) -> int:
        """0, or a key of FAULTS."""
        return int(find_fault(self.arrays)) or 2 * int(self._overflowed())

    def _overflowed(self) -> bool:
        number = self.data.warning.number
        full = (mujoco.mjtWarning.mjWARN_CONTACTFULL, mujoco.mjtWarning.mjWARN_CNSTRFULL)
        return any(number[int(kind)] > 0 for kind in full)


@njit(cache=True, nogil=True, inline="always")
def physics_step(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """One physics step towards (12,) targets; returns Σ torque² over the joints [(N·m)²].

    Leaves the motors' torque on the joints (the engine's damping included) in ``world.torque``.
    """
    total, n = 0.0, target.shape[0]
    q, dq = world.qpos[world.qpos.shape[0] - n :], world.qvel[world.qvel.shape[0] - n :]
    applied = world.applied[world.applied.shape[0] - n :]
    step_actuator(motors, world.physics_dt, target, q, dq, world.torque)
    for joint in range(n):
        applied[joint] = world.torque[joint]
        world.damping[joint] = motors.damping[joint]
    mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]
    for joint in range(n):
        world.torque[joint] -= world.damping[joint] * dq[joint]
        total += world.torque[joint] * world.torque[joint]
    return total


@njit(cache=True, nogil=True, inline="always")
def hold_target(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """Hold (12,) targets for one control step; returns Σ torque², mean over the physics steps [(N·m)²]."""
    total = 0.0
    for _ in range(world.substeps):
        total += physics_step(world, motors, target)
    return total / world.substeps


@njit(cache=True, nogil=True)
def find_fault(world: WorldArrays) -> int:
    """1 if a coordinate is not finite, else 0."""
    for value in world.qpos:
        if not np.isfinite(value):
            return 1
    return 0


@njit(cache=True, nogil=True)
def read_joints(world: WorldArrays, motors: ActuatorArrays, out: np.ndarray) -> None:
    """(12,) joint angles [rad] as the encoders report them."""
    measure_joint_pos(motors, world.qpos[world.qpos.shape[0] - out.shape[0] :], out)
