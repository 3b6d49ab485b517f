"""One robot in MuJoCo: model, data, and views of their memory for compiled code."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, require_motors, with_factors
from motorprior.actuator.kernels import reset_actuator
from motorprior.backend import BackendState
from motorprior.exceptions import ConfigError
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import MAX_DELAY, Conditions, nominal_conditions
from motorprior.simulation.world_step import WorldArrays, hold_target, prepare_mujoco, read_state

_RANDOMIZED = ("body_mass", "body_inertia", "body_ipos", "pair_friction")


def substeps_of(control_dt: float, physics_dt: float) -> int:
    """Physics steps per control step; ConfigError if physics_dt [s] does not divide control_dt [s]."""
    count = round(control_dt / physics_dt)
    if count < 1 or abs(count * physics_dt - control_dt) > 1e-9:
        raise ConfigError(f"physics_dt {physics_dt} s does not divide control_dt {control_dt} s")
    return count


class World:
    """A simulated robot. Use one per thread.

    The steps ``physics_dt``, which must divide ``control_dt``, and ``control_dt``, for which a position target is held
    [s], are the robot's own if not given. ``suspended`` fixes a free base in the air.

    Raises:
        ConfigError: a physics step that does not divide the control step; a fixed base cannot be suspended.
        ArtifactError: see `build_model`.
    """

    def __init__(
        self, robot: Robot, physics_dt: float | None = None, suspended: bool = False, control_dt: float | None = None
    ):
        self.robot, self.is_fixed = robot, suspended or robot.base == "fixed"
        self.physics_dt, self.control_dt = physics_dt or robot.physics_dt, control_dt or robot.control_dt
        self.substeps = substeps_of(self.control_dt, self.physics_dt)
        step = prepare_mujoco()
        self.model = build_model(robot, self.physics_dt, suspended)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.first_joint, self.first_dof = (0, 0) if self.is_fixed else (7, 6)
        joints = robot.num_joints
        self._nominal_conditions = nominal_conditions(robot)
        self.arrays = WorldArrays(
            step=step,
            model=self.model._address,
            data=self.data._address,
            qpos=self.data.qpos,
            qvel=self.data.qvel,
            applied=self.data.qfrc_applied,
            damping=self.model.dof_damping[self.first_dof :],
            passive=np.zeros(joints),
            strength=np.ones(joints),
            torque=np.zeros(joints),
            encoder_offset=np.zeros(joints),
            commands=np.zeros((int(np.ceil(2.0 * MAX_DELAY / self.control_dt)) + 1, joints)),  # delay and jitter
            clock=np.zeros(1, np.int64),
            delays=np.zeros(1, np.int64),
            geoms=self.data.geom_xpos,
            feet=np.array([self.model.geom(leg.foot).id for leg in robot.legs], np.int64),
            warnings=self.data.warning.number,
            push=np.zeros((0, 2)),
            physics_dt=self.physics_dt,
            substeps=self.substeps,
        )
        self._applied = self._nominal_conditions
        self._nominal = {name: getattr(self.model, name).copy() for name in _RANDOMIZED}

    def reset(
        self, actuator: Actuator, joint_pos: np.ndarray | None = None, conditions: Conditions | None = None
    ) -> ActuatorArrays:
        """Stand at ``joint_pos`` (joints,) [rad], at rest, on these motors; returns the motors' arrays.

        The pose and the conditions are the robot's nominal ones if not given.
        """
        joint_pos = self.robot.nominal_pose if joint_pos is None else joint_pos
        conditions = self._nominal_conditions if conditions is None else conditions
        require_motors(actuator, self.robot.num_joints)
        actuator = with_factors(actuator, conditions.factors)
        self._apply(conditions)
        mujoco.mj_resetData(self.model, self.data)
        self.model.dof_armature[self.first_dof :] = actuator.armature + conditions.armature
        arrays = self.arrays
        arrays.passive[:] = conditions.damping
        arrays.strength[:] = conditions.strength
        arrays.damping[:] = conditions.strength * actuator.damping + conditions.damping
        arrays.encoder_offset[:] = conditions.encoder_offset
        arrays.commands[:] = joint_pos
        arrays.clock[:] = 0
        arrays.torque[:] = 0.0  # or a trace would begin with the previous episode's
        self.arrays = arrays._replace(push=conditions.push, delays=conditions.delay_steps(self.physics_dt))
        self.data.qpos[self.first_joint :] = joint_pos
        motors = actuator.arrays(self.physics_dt)
        reset_actuator(motors, np.ascontiguousarray(joint_pos), np.ascontiguousarray(joint_pos))
        return motors

    def _apply(self, conditions: Conditions) -> None:
        """Write masses, friction and gravity of these conditions into the model, without compiling it again."""
        names = "mass", "com", "gravity", "friction"
        if all(np.array_equal(getattr(conditions, name), getattr(self._applied, name)) for name in names):
            return
        self._applied = conditions
        for name, value in self._nominal.items():
            getattr(self.model, name)[:] = value
        model, links = self.model, slice(1, None)  # body 0 is the world
        model.body_mass[links] *= conditions.mass
        model.body_inertia[links] *= conditions.mass[:, None]
        model.body_ipos[1] += conditions.com
        model.pair_friction[:, :2] *= conditions.friction
        model.opt.gravity[:] = conditions.gravity
        model.dof_armature[:] = 0.0  # as when the model was compiled: the result must not depend on earlier motors
        mujoco.mj_setConst(model, self.data)  # update the constants that MuJoCo derives from masses

    def hold(self, motors: ActuatorArrays, target: np.ndarray) -> float:
        """See `world_step.hold_target`."""
        return hold_target(self.arrays, motors, target)

    def state(self, motors: ActuatorArrays, torque_squared_sum: float) -> BackendState:
        """State of a free robot, a copy; see `world_step.read_state`."""
        measured, feet = np.zeros(self.robot.num_joints), np.zeros((len(self.robot.legs), 3))
        pos, quat, lin_vel, ang_vel, *_, fault = read_state(self.arrays, motors, torque_squared_sum, measured, feet)
        base = pos.copy(), quat.copy(), lin_vel.copy(), ang_vel.copy()
        return BackendState(*base, measured, feet, torque_squared_sum, fault)

    def close(self) -> None:
        """Nothing to close."""
