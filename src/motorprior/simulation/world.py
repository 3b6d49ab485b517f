"""One robot in MuJoCo: model, data, and the views of their memory that compiled code works on."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.actuator.torque_law import measure_joint_pos, reset_actuator, step_actuator
from motorprior.compiled import njit
from motorprior.delay_line import row_of_age, write_line
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot
from motorprior.simulation.build_model import build_model
from motorprior.simulation.fatal_errors import install_handler
from motorprior.simulation.mj_call import mj_step, mj_step_address, stop_timers
from motorprior.simulation.randomization import LONGEST_DELAY, Conditions, nominal_conditions

FAULTS = {
    1: "a coordinate, speed or acceleration is not finite or huge",
    2: "MuJoCo ran out of contact or constraint memory",
    3: "the robot's mass matrix is singular: a link without inertia",
}
"""Meaning of the fault numbers of `BackendState`."""
FURTHEST = 1e3
"""Base position [m] beyond which a simulation counts as diverged."""
FASTEST = 1e2
"""Base speed [m/s] beyond which a simulation counts as diverged."""
FASTEST_TURN = 1e3
"""Angular speed of base or joints [rad/s] beyond which a simulation counts as diverged: far above any motion of the
robot, far below the speeds that a physics step too long for the motors' gains leads to."""
_WARNING = mujoco.mjtWarning
_FULL = (int(_WARNING.mjWARN_CONTACTFULL), int(_WARNING.mjWARN_CNSTRFULL))
_SINGULAR = int(_WARNING.mjWARN_INERTIA)
_BAD = (int(_WARNING.mjWARN_BADQPOS), int(_WARNING.mjWARN_BADQVEL), int(_WARNING.mjWARN_BADQACC))
_RANDOMIZED = ("body_mass", "body_inertia", "body_ipos", "pair_friction")


@dataclass(frozen=True)
class WorldConfig:
    """How the robot is simulated.

    Attributes:
        robot: which.
        physics_dt: step [s]; must divide control_dt.
        control_dt: time a position target is held [s].
        foot_friction: sliding friction [-].
        hung: a free base is fixed in the air.
    """

    robot: Robot
    physics_dt: float
    control_dt: float
    foot_friction: float
    hung: bool = False

    @classmethod
    def of(
        cls,
        robot: Robot,
        *,
        physics_dt: float | None = None,
        control_dt: float | None = None,
        foot_friction: float | None = None,
        hung: bool = False,
    ) -> WorldConfig:
        """The robot's own clocks and friction where no others are given."""
        return cls(
            robot,
            robot.physics_dt if physics_dt is None else physics_dt,
            robot.control_dt if control_dt is None else control_dt,
            robot.foot_friction if foot_friction is None else foot_friction,
            hung,
        )

    @property
    def is_fixed(self) -> bool:
        """Whether the base cannot move."""
        return self.hung or self.robot.base == "fixed"

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
    """(nv,) generalized force, the last are the joints'"""
    damping: np.ndarray
    """(joints,) implicit damping of the joints in the model [N·m·s/rad], a view"""
    passive: np.ndarray
    """(joints,) part of the damping that does not come from motors [N·m·s/rad]"""
    torque: np.ndarray
    """(joints,) scratch"""
    encoder_offset: np.ndarray
    """(joints,) reading of the encoders at true zero [rad]"""
    commands: np.ndarray
    """(rows, joints) position targets of the latest control steps, in true angles [rad]: a delay line; state"""
    clock: np.ndarray
    """(1,) int64: control steps since reset; state"""
    delays: np.ndarray
    """(steps,) or (1,) int64: age of the targets in each control step [physics steps]"""
    geoms: np.ndarray
    """(geoms, 3) places of the geoms at the beginning of the last physics step [m], a view"""
    feet: np.ndarray
    """(legs,) int64: the feet among the geoms"""
    warnings: np.ndarray
    """(kinds of warning,) int32: how often MuJoCo gave each since the reset"""
    push: np.ndarray
    """(steps, 2) horizontal force on the chassis in each control step [N], or (0, 2)"""
    physics_dt: float
    substeps: int


def _links(conditions: Conditions) -> np.ndarray:
    """The conditions that change the model, except those of joints."""
    return np.concatenate([conditions.mass, conditions.com, conditions.gravity, [conditions.friction]])


def _keep_quiet(message: str) -> None:
    """Ignore a warning; otherwise MuJoCo would write MUJOCO_LOG.TXT. Faults are found from the state instead."""


class World:
    """A simulated robot. Use one per thread.

    Making one changes the whole process, other models of MuJoCo included: no warning is printed or written to a file
    any more (``mjData.warning`` still counts them), MuJoCo's timers stand still (`mj_call.stop_timers`), and a fatal
    error in compiled code ends the process with one line (`fatal_errors`).
    """

    def __init__(self, config: WorldConfig):
        self.config = config
        mujoco.set_mju_user_warning(_keep_quiet)
        stop_timers()
        install_handler()
        self.model = build_model(config.robot, config.physics_dt, config.foot_friction, config.hung)
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
            torque=np.zeros(joints),
            encoder_offset=np.zeros(joints),
            commands=np.zeros((int(np.ceil(2.0 * LONGEST_DELAY / config.control_dt)) + 1, joints)),  # delay and jitter
            clock=np.zeros(1, np.int64),
            delays=np.zeros(1, np.int64),
            geoms=self.data.geom_xpos,
            feet=np.array([self.model.geom(leg.foot).id for leg in config.robot.legs], np.int64),
            warnings=self.data.warning.number,
            push=np.zeros((0, 2)),
            physics_dt=config.physics_dt,
            substeps=config.substeps,
        )
        self._applied = _links(self._nominal_conditions)
        self._nominal = {name: getattr(self.model, name).copy() for name in _RANDOMIZED}

    def reset(
        self, actuator: Actuator, joint_pos: np.ndarray | None = None, conditions: Conditions | None = None
    ) -> ActuatorArrays:
        """Stand at ``joint_pos`` (joints,) [rad], at rest, on these motors; returns the motors' fresh arrays.

        The pose and the conditions are the robot's nominal ones if not given.
        """
        joint_pos = self.config.robot.nominal_pose if joint_pos is None else joint_pos
        conditions = self._nominal_conditions if conditions is None else conditions
        self._apply(conditions)
        mujoco.mj_resetData(self.model, self.data)
        self.model.dof_armature[self.first_dof :] = actuator.armature + conditions.armature
        arrays = self.arrays
        arrays.passive[:] = conditions.damping
        arrays.damping[:] = actuator.damping + conditions.damping
        arrays.encoder_offset[:] = conditions.encoder_offset
        arrays.commands[:] = joint_pos
        arrays.clock[:] = 0
        arrays.torque[:] = 0.0  # or a trace began with the last episode's
        self.arrays = arrays._replace(push=conditions.push, delays=conditions.delay_steps(self.config.physics_dt))
        self.data.qpos[self.first_joint :] = joint_pos
        motors = actuator.arrays(self.config.physics_dt)
        reset_actuator(motors, np.ascontiguousarray(joint_pos), np.ascontiguousarray(joint_pos))
        return motors

    def _apply(self, conditions: Conditions) -> None:
        """Write masses, friction and gravity of these conditions into the model, without compiling it again."""
        wanted = _links(conditions)
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
        mujoco.mj_setConst(model, self.data)  # what MuJoCo derives from masses

    def fault(self) -> int:
        """0, or a key of FAULTS."""
        return int(find_fault(self.arrays))


@njit(cache=True, nogil=True, inline="always")
def physics_step(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """One physics step towards (joints,) targets; returns Σ torque² over the joints [(N·m)²].

    Leaves the motors' torque on the joints (the damping that the engine integrates included) in ``world.torque``.
    """
    total, n = 0.0, target.shape[0]
    q, dq = world.qpos[world.qpos.shape[0] - n :], world.qvel[world.qvel.shape[0] - n :]
    applied = world.applied[world.applied.shape[0] - n :]
    step_actuator(motors, world.physics_dt, target, q, dq, world.torque)
    for joint in range(n):
        applied[joint] = world.torque[joint]
        world.damping[joint] = motors.damping[joint] + world.passive[joint]
    mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]
    for joint in range(n):
        world.torque[joint] -= motors.damping[joint] * dq[joint]
        total += world.torque[joint] * world.torque[joint]
    return total


@njit(cache=True, nogil=True, inline="always")
def control_steps_late(delays: np.ndarray, step: int, substep: int, substeps: int) -> int:
    """Age of the target in force, the newest that has come, in control steps; the same in every engine.

    Args:
        delays: (steps,) or (1,) how late the target of every control step comes [physics steps].
        step: control steps since the reset.
        substep: physics steps since the control step began.
        substeps: physics steps per control step.
    """
    late = 0
    while late <= step and delays[(step - late) % delays.shape[0]] > late * substeps + substep:
        late += 1
    return late


@njit(cache=True, nogil=True, inline="always")
def hold_target(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """Hold (joints,) targets for one control step; returns Σ torque², mean over the physics steps [(N·m)²].

    The motors get the targets as late as ``world.delays`` says, in the angles of their own encoders; a push acts
    on the origin of the chassis.
    """
    step = world.clock[0]
    newest = write_line(world.commands, 0, step, target)
    for joint in range(target.shape[0]):
        world.commands[newest, joint] -= world.encoder_offset[joint]
    if world.push.shape[0] > 0:
        here = step % world.push.shape[0]
        world.applied[0], world.applied[1] = world.push[here, 0], world.push[here, 1]
    total = 0.0
    for k in range(world.substeps):
        late = control_steps_late(world.delays, step, k, world.substeps)
        total += physics_step(world, motors, world.commands[row_of_age(world.commands, 0, newest, late)])
    world.clock[0] = step + 1
    return total / world.substeps


@njit(cache=True, nogil=True)
def has_broken_down(qpos: np.ndarray, qvel: np.ndarray) -> bool:
    """Whether a state is not finite or beyond FURTHEST, FASTEST or FASTEST_TURN: fault 1, in every engine.

    Args:
        qpos: base position (3,) [m], base quaternion (4,) and joint angles [rad]; only angles for a fixed robot.
        qvel: base velocity (3,) [m/s], angular velocity (3,) [rad/s] and joint velocities [rad/s]; likewise.
    """
    free = qpos.shape[0] > qvel.shape[0]
    for index in range(qpos.shape[0]):
        if not np.isfinite(qpos[index]) or (free and index < 3 and abs(qpos[index]) > FURTHEST):
            return True
    for index in range(qvel.shape[0]):
        largest = FASTEST if free and index < 3 else FASTEST_TURN
        if not abs(qvel[index]) <= largest:  # true for NaN too
            return True
    return False


@njit(cache=True, nogil=True, inline="always")
def find_fault(world: WorldArrays) -> int:
    """Key of FAULTS of the fault since the reset, or 0."""
    if world.warnings[_FULL[0]] > 0 or world.warnings[_FULL[1]] > 0:
        return 2
    for kind in _BAD:
        if world.warnings[kind] > 0:
            return 1
    if has_broken_down(world.qpos, world.qvel):
        return 1
    return 3 if world.warnings[_SINGULAR] > 0 else 0  # a state that breaks down makes it singular too


@njit(cache=True, nogil=True, inline="always")
def read_joints(world: WorldArrays, motors: ActuatorArrays, out: np.ndarray) -> None:
    """(joints,) joint angles [rad] as the encoders report them."""
    measure_joint_pos(motors, world.qpos[world.qpos.shape[0] - out.shape[0] :], out)
    for joint in range(out.shape[0]):
        out[joint] += world.encoder_offset[joint]
