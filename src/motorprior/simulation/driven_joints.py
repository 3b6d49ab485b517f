"""Motors on the joints of any MuJoCo model: the user's own loop calls `drive` before every ``mj_step``."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from collections.abc import Sequence

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motors import Motors
from motorprior.exceptions import ConfigError, SimulationFault

# integers, since an enumeration of MuJoCo 4 does not equal a numpy integer; forces on sites and
# bodies drive no joint
_ON_BODIES = [int(getattr(mujoco.mjtTrn, f"mjTRN_{name}")) for name in ("SITE", "BODY")]
_POSES = 3  # the initial one, and others near it: a tendon may cross a joint's axis in one of them
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_COUPLES_JOINTS = int(mujoco.mjtEq.mjEQ_JOINT)
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
_BAD = [int(getattr(mujoco.mjtWarning, f"mjWARN_BADQ{name}")) for name in ("POS", "VEL", "ACC")]


class DrivenJoints:
    """Motors that drive some joints of a model.

    They replace the joints' own armature, damping and dry friction. With the motors' torque and
    damping (`Motors`),

        data.qfrc_applied = torque - damping·joint_vel,    model.dof_armature = armature + timestep·damping,

    which is the motors' implicit damping, also in the forces of contacts and equality constraints.
    The motors start at rest at ``data.qpos``, also after ``mj_resetData``; after other changes of
    ``data.qpos`` call `reset`. The compiled model is changed in place; ``joints`` names hinges, one
    per motor.

    ConfigError for an unknown joint, one that is not a hinge or that an actuator of the model
    drives, two joints that the model couples, another number of joints than motors, the integrator
    RK4, or a timestep that the motors do not support.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, actuator: Actuator, joints: Sequence[str]
    ):
        if int(model.opt.integrator) == _RK4:
            remedy = 'use <option integrator="implicitfast"/>, "implicit" or "Euler"'
            raise ConfigError(
                "the model's integrator RK4 evaluates forces between the motors' steps",
                remedy=remedy,
            )
        if len(joints) != actuator.num_motors:
            problem = f"{len(joints)} joints for {actuator.num_motors} motors"
            raise ConfigError(problem, remedy="sample one motor per joint")
        if len(set(joints)) < len(joints):
            raise ConfigError(
                f"joints {', '.join(joints)} repeat",
                remedy="name each joint once",
                argument="joints",
            )
        found = [hinge(model, name) for name in joints]
        _require_undriven(model, found)
        require_uncoupled(model, found)
        self._model = model
        self._data = data
        self._time = -np.inf
        self._pos = model.jnt_qposadr[found]
        self._dof = model.jnt_dofadr[found]
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

    def drive(self, position_target: np.ndarray) -> np.ndarray:
        """Write the motors of the next step to model and data; returns the torque without damping (n,) [N·m].

        Raises:
            ConfigError: targets of another shape, or a state that is not finite.
            SimulationFault: MuJoCo reset the simulation, since it diverged.
        """
        if self._data.warning.number[_BAD].any():
            remedy = "use a shorter timestep or softer constraints; mj_resetData starts again"
            raise SimulationFault(
                f"MuJoCo reset a simulation that diverged, after {self._time:.4g} s", remedy=remedy
            )
        if self._data.time <= self._time:
            self.reset()
        self._time = self._data.time
        vel = self._data.qvel[self._dof]
        torque, damping = self._motors.step(position_target, self._data.qpos[self._pos], vel)
        self._data.qfrc_applied[self._dof] = torque - damping * vel
        self._set_damping(damping)
        return torque

    def _set_damping(self, damping: np.ndarray) -> None:
        self._model.dof_armature[self._dof] = (
            self._motors.armature + self._model.opt.timestep * damping
        )


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
    for actuator, joint in np.argwhere(drives(model)[:, joints]).tolist():
        name = model.actuator(actuator).name or actuator
        problem = (
            f"joint {model.joint(joints[joint]).name!r} is driven by the model's actuator {name!r}"
        )
        raise ConfigError(
            problem, remedy="delete that actuator, or the joint would be driven twice"
        )


def drives(model: mujoco.MjModel) -> np.ndarray:
    """(actuators, joints) whether one on a joint or tendon has a moment arm on the joint, in some of _POSES."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    count = len(model.actuator_trntype)
    arms = np.zeros((count, model.nv))
    found = np.zeros((count, model.nv), bool)
    for pose in range(_POSES if count else 0):
        mujoco.mj_resetData(model, data)
        mujoco.mj_integratePos(
            model, data.qpos, 0.3 * rng.standard_normal(model.nv) * (pose > 0), 1.0
        )
        mujoco.mj_fwdPosition(model, data)
        rows = data.moment_rownnz, data.moment_rowadr, data.moment_colind
        mujoco.mju_sparse2dense(arms, data.actuator_moment, *rows)
        found |= arms != 0.0
    found[np.isin(model.actuator_trntype, _ON_BODIES)] = False
    return found[:, model.jnt_dofadr]


def require_uncoupled(model: mujoco.MjModel, joints: Sequence[int]) -> None:
    """Raise ConfigError if an equality constraint couples two of the joints: one motor drives both."""
    constraints = zip(
        model.eq_obj1id, model.eq_obj2id, model.eq_type, model.eq_active0, strict=True
    )
    for first, second, kind, is_active in constraints:
        if is_active and kind == _COUPLES_JOINTS and {int(first), int(second)} <= set(joints):
            names = model.joint(first).name, model.joint(second).name
            problem = f"an equality constraint couples joint {names[0]!r} to {names[1]!r}: one motor drives both"
            raise ConfigError(problem, remedy=f"drive {names[1]!r} alone")
