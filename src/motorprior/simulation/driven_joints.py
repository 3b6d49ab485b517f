"""Motors on the joints of any MuJoCo model.

The user's own loop calls `DrivenJoints.drive` before every ``mj_step``.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motors import Motors
from motorprior.exceptions import ConfigError, SimulationFault

# Poses in which moment arms are computed: the initial one, and others near it. A tendon may cross a
# joint's axis in one of them.
_POSES = 3

# MuJoCo's constants as integers, since an enumeration of MuJoCo 4 does not equal a numpy integer
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_COUPLES_JOINTS = int(mujoco.mjtEq.mjEQ_JOINT)
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
# forces on sites and bodies drive no joint
_ON_BODIES = [int(mujoco.mjtTrn.mjTRN_SITE), int(mujoco.mjtTrn.mjTRN_BODY)]
_DIVERGED = [
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


class DrivenJoints:
    """Motors that drive some joints of a model.

    They replace the joints' own armature, damping and dry friction. With torque and damping of the
    motors (`Motors`),

        data.qfrc_applied = torque - damping·joint_vel
        model.dof_armature = armature + timestep·damping

    This makes the motors' damping implicit, also in the forces of contacts and equality
    constraints. The motors start at rest at ``data.qpos``, also after ``mj_resetData``; after other
    changes of ``data.qpos`` call `reset`.

    Args:
        model: a compiled model, which is changed in place.
        data: the model's state.
        actuator: the motors.
        joints: names of hinges, one per motor.

    Raises:
        ConfigError: an unknown joint, one that is not a hinge or that an actuator of the model
            drives, two joints that the model couples, another number of joints than motors, the
            integrator RK4, or a timestep that the motors do not support.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, actuator: Actuator, joints: Sequence[str]
    ):
        if int(model.opt.integrator) == _RK4:
            problem = "the model's integrator RK4 evaluates forces between the motors' steps"
            remedy = 'use <option integrator="implicitfast"/>, "implicit" or "Euler"'
            raise ConfigError(problem, remedy=remedy)
        if len(joints) != actuator.num_motors:
            problem = f"{len(joints)} joints for {actuator.num_motors} motors"
            raise ConfigError(problem, remedy="sample one motor per joint")
        if len(set(joints)) < len(joints):
            problem = f"joints {', '.join(joints)} repeat"
            raise ConfigError(problem, remedy="name each joint once", argument="joints")
        hinges = [hinge(model, name) for name in joints]
        _require_undriven(model, hinges)
        require_uncoupled(model, hinges)

        self._model = model
        self._data = data
        self._time = -np.inf  # of the last call of `drive` [s]
        self._pos = model.jnt_qposadr[hinges]
        self._dof = model.jnt_dofadr[hinges]
        self._motors = Motors(actuator, model.opt.timestep, data.qpos[self._pos])

        self._set_damping(actuator.damping)
        model.dof_frictionloss[self._dof] = 0.0
        model.dof_damping[self._dof] = 0.0
        # update the constants that MuJoCo derives from inertias
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def reset(self) -> None:
        """Restart the motors, at rest at the present joint positions."""
        self._motors.reset(self._data.qpos[self._pos])
        self._time = -np.inf

    def drive(
        self,
        position_target: np.ndarray,
        *,
        velocity_target: np.ndarray | float = 0.0,
        torque_feedforward: np.ndarray | float = 0.0,
        kp_factor: np.ndarray | float = 1.0,
        kd_factor: np.ndarray | float = 1.0,
    ) -> np.ndarray:
        """Write the motors' effect in the next step to model and data.

        The command is that of `Motors.step`. Returns the torque without damping (n,) [N·m].

        Raises:
            ConfigError: commands of another shape, a state that is not finite, or motors that take
                position commands only.
            SimulationFault: MuJoCo reset the simulation, since it diverged.
        """
        if self._data.warning.number[_DIVERGED].any():
            problem = f"MuJoCo reset a simulation that diverged, after {self._time:.4g} s"
            remedy = "use a shorter timestep or softer constraints; mj_resetData starts again"
            raise SimulationFault(problem, remedy=remedy)

        was_reset = self._data.time <= self._time
        if was_reset:
            self.reset()

        self._time = self._data.time
        vel = self._data.qvel[self._dof]
        torque, damping = self._motors.step(
            position_target,
            self._data.qpos[self._pos],
            vel,
            velocity_target=velocity_target,
            torque_feedforward=torque_feedforward,
            kp_factor=kp_factor,
            kd_factor=kd_factor,
        )
        self._data.qfrc_applied[self._dof] = torque - damping * vel
        self._set_damping(damping)
        return torque

    def _set_damping(self, damping: np.ndarray) -> None:
        implicit_damping = self._model.opt.timestep * damping
        self._model.dof_armature[self._dof] = self._motors.armature + implicit_damping


def hinge(model: mujoco.MjModel, name: str) -> int:
    """The index of a joint; raises ConfigError for an unknown one, or one that is no hinge."""
    try:
        joint = model.joint(name).id
    except KeyError as error:  # its message lists the joints of the model
        raise ConfigError(f"no joint {name!r} in the model", remedy=str(error.args[0])) from error
    if model.jnt_type[joint] != _HINGE:
        raise ConfigError(f"joint {name!r} is no hinge", remedy="give hinges only")
    return joint


def _require_undriven(model: mujoco.MjModel, joints: Sequence[int]) -> None:
    for actuator, index in np.argwhere(drives(model)[:, joints]).tolist():
        joint_name = model.joint(joints[index]).name
        actuator_name = model.actuator(actuator).name or actuator
        problem = f"joint {joint_name!r} is driven by the model's actuator {actuator_name!r}"
        remedy = "delete that actuator, or the joint would be driven twice"
        raise ConfigError(problem, remedy=remedy)


def drives(model: mujoco.MjModel) -> np.ndarray:
    """(actuators, joints) whether an actuator of the model drives a joint.

    The actuator acts on a joint or tendon, and has a moment arm on the joint in one of _POSES
    poses.
    """
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    count = len(model.actuator_trntype)
    arms = np.zeros((count, model.nv))
    has_arm = np.zeros((count, model.nv), bool)
    if count == 0:
        return has_arm[:, model.jnt_dofadr]

    for pose in range(_POSES):
        offset = 0.3 * rng.standard_normal(model.nv) * (pose > 0)
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(model, data.qpos, offset, 1.0)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mju_sparse2dense(
            arms, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        has_arm |= arms != 0.0

    has_arm[np.isin(model.actuator_trntype, _ON_BODIES)] = False
    return has_arm[:, model.jnt_dofadr]


def require_uncoupled(model: mujoco.MjModel, joints: Sequence[int]) -> None:
    """Raise ConfigError if an equality constraint couples two of the joints."""
    for constraint in range(model.neq):
        if not model.eq_active0[constraint] or model.eq_type[constraint] != _COUPLES_JOINTS:
            continue
        first = int(model.eq_obj1id[constraint])
        second = int(model.eq_obj2id[constraint])
        if first in joints and second in joints:
            names = f"joint {model.joint(first).name!r} to {model.joint(second).name!r}"
            problem = f"an equality constraint couples {names}: one motor drives both"
            raise ConfigError(problem, remedy=f"drive {model.joint(second).name!r} alone")
