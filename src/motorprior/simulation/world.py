"""One robot in MuJoCo: model, data, and views of their memory for compiled code."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, require_motors, with_factors
from motorprior.actuator.kernels import reset_actuator
from motorprior.robots.build_model import build_model
from motorprior.simulation.fatal_errors import install_handler
from motorprior.simulation.mj_call import mj_step_address, stop_timers
from motorprior.simulation.randomization import MAX_DELAY, Conditions, nominal_conditions
from motorprior.simulation.world_config import WorldConfig
from motorprior.simulation.world_step import WorldArrays, find_fault

_RANDOMIZED = ("body_mass", "body_inertia", "body_ipos", "pair_friction")


def _model_changes(conditions: Conditions) -> np.ndarray:
    """The conditions that change the model, except those of joints."""
    return np.concatenate([conditions.mass, conditions.com, conditions.gravity, [conditions.friction]])


def _ignore(message: str) -> None:
    """Ignore a warning; otherwise MuJoCo writes MUJOCO_LOG.TXT. Faults are detected from the state."""


class World:
    """A simulated robot. Use one per thread.

    The first one changes MuJoCo in the whole process: warnings are only counted (``mjData.warning``), timers stop
    (`mj_call.stop_timers`), and a fatal error in compiled code ends the process with one line (`fatal_errors`).
    """

    def __init__(self, config: WorldConfig):
        self.config = config
        mujoco.set_mju_user_warning(_ignore)
        stop_timers()
        install_handler()
        self.model = build_model(config.robot, config.physics_dt, config.suspended)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.first_joint = 0 if config.is_fixed else 7
        self.first_dof = 0 if config.is_fixed else 6
        joints = config.robot.num_joints
        self._nominal_conditions = nominal_conditions(config.robot)
        self.arrays = WorldArrays(
            step=mj_step_address(),
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
            commands=np.zeros((int(np.ceil(2.0 * MAX_DELAY / config.control_dt)) + 1, joints)),  # delay and jitter
            clock=np.zeros(1, np.int64),
            delays=np.zeros(1, np.int64),
            geoms=self.data.geom_xpos,
            feet=np.array([self.model.geom(leg.foot).id for leg in config.robot.legs], np.int64),
            warnings=self.data.warning.number,
            push=np.zeros((0, 2)),
            physics_dt=config.physics_dt,
            substeps=config.substeps,
        )
        self._applied = _model_changes(self._nominal_conditions)
        self._nominal = {name: getattr(self.model, name).copy() for name in _RANDOMIZED}

    def reset(
        self, actuator: Actuator, joint_pos: np.ndarray | None = None, conditions: Conditions | None = None
    ) -> ActuatorArrays:
        """Stand at ``joint_pos`` (joints,) [rad], at rest, on these motors; returns the motors' arrays.

        The pose and the conditions are the robot's nominal ones if not given.
        """
        joint_pos = self.config.robot.nominal_pose if joint_pos is None else joint_pos
        conditions = self._nominal_conditions if conditions is None else conditions
        require_motors(actuator, self.config.robot.num_joints)
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
        self.arrays = arrays._replace(push=conditions.push, delays=conditions.delay_steps(self.config.physics_dt))
        self.data.qpos[self.first_joint :] = joint_pos
        motors = actuator.arrays(self.config.physics_dt)
        reset_actuator(motors, np.ascontiguousarray(joint_pos), np.ascontiguousarray(joint_pos))
        return motors

    def _apply(self, conditions: Conditions) -> None:
        """Write masses, friction and gravity of these conditions into the model, without compiling it again."""
        wanted = _model_changes(conditions)
        if np.array_equal(wanted, self._applied):
            return
        self._applied = wanted
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

    def fault(self) -> int:
        """0, or a key of FAULTS."""
        return int(find_fault(self.arrays))
