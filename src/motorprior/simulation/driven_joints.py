"""Motors on the joints of any MuJoCo model: the user's own loop calls `drive` before every ``mj_step``."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motors import Motors
from motorprior.exceptions import ConfigError

_OF_JOINTS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
_INTEGRATORS = (
    mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
)  # fmt: skip


class DrivenJoints:
    """Motors that drive some joints of a model.

    They replace the joints' own armature, damping and dry friction. The torque is written to ``data.qfrc_applied``, the
    damping to ``model.dof_damping``, which the integrator treats implicitly. The motors start at rest at ``data.qpos``,
    also after ``mj_resetData``; after other changes of ``data.qpos`` call `reset`. The compiled model is changed in
    place; ``joints`` names hinges, one per motor.

    ConfigError for an unknown joint, one that is not a hinge or that the model already drives, another number of joints
    than motors, an integrator without implicit damping, or a timestep that the motors do not support.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, actuator: Actuator, joints: Sequence[str]):
        if model.opt.integrator not in _INTEGRATORS or model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP:
            remedy = 'use <option integrator="implicitfast"/>, "implicit", or "Euler" with no flag eulerdamp="disable"'
            raise ConfigError("the model's integrator does not damp its joints implicitly", remedy=remedy)
        if len(joints) != actuator.num_motors:
            problem = f"{len(joints)} joints for {actuator.num_motors} motors"
            raise ConfigError(problem, remedy="sample one motor per joint")
        found = [_hinge(model, name) for name in joints]
        self._model, self._data, self._time = model, data, -np.inf
        self._pos, self._dof = model.jnt_qposadr[found], model.jnt_dofadr[found]
        self._motors = Motors(actuator, model.opt.timestep, data.qpos[self._pos])
        model.dof_armature[self._dof] = self._motors.armature
        model.dof_frictionloss[self._dof] = 0.0
        model.dof_damping[self._dof] = actuator.damping
        mujoco.mj_setConst(model, mujoco.MjData(model))  # update the constants that MuJoCo derives from inertias

    def reset(self) -> None:
        """Restart the motors, at rest at the present joint positions."""
        self._motors.reset(self._data.qpos[self._pos])
        self._time = -np.inf

    def drive(self, position_target: np.ndarray) -> np.ndarray:
        """Write torque and damping of the next step to model and data; returns the torque (n,) [N·m].

        ConfigError for targets of another shape, or a state that is not finite.
        """
        if self._data.time <= self._time:
            self.reset()
        self._time = self._data.time
        torque, damping = self._motors.step(position_target, self._data.qpos[self._pos], self._data.qvel[self._dof])
        self._data.qfrc_applied[self._dof] = torque
        self._model.dof_damping[self._dof] = damping
        return torque


def _hinge(model: mujoco.MjModel, name: str) -> int:
    try:
        joint = model.joint(name).id
    except KeyError as error:  # its message lists the joints of the model
        raise ConfigError(f"no joint {name!r} in the model", remedy=str(error.args[0])) from error
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
        raise ConfigError(f"joint {name!r} is no hinge", remedy="give hinges only")
    for actuator in range(model.nu):
        if model.actuator_trntype[actuator] in _OF_JOINTS and model.actuator_trnid[actuator, 0] == joint:
            problem = f"joint {name!r} is driven by the model's actuator {model.actuator(actuator).name!r}"
            raise ConfigError(problem, remedy="delete that actuator, or the joint would be driven twice")
    return joint
