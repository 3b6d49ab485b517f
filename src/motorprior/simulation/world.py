"""One robot in MuJoCo: model, data, and views of their memory for compiled code."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
import ctypes
import os
import sys
from typing import NamedTuple

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from motorprior.actuator.actuator import Actuator, ActuatorArrays, require_motors, with_factors
from motorprior.actuator.kernels import measure_joint_pos, reset_actuator, step_actuator
from motorprior.compiled import njit
from motorprior.delay_line import row_of_age, write_line
from motorprior.exceptions import ConfigError
from motorprior.locomotion.control_step import RobotState
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import MAX_DELAY, EpisodeConditions, nominal_conditions

_RANDOMIZED = ("body_mass", "body_inertia", "body_ipos", "pair_friction")


def substeps_of(control_dt: float, physics_dt: float) -> int:
    """Physics steps per control step; ConfigError if physics_dt [s] does not divide control_dt [s]."""
    count = round(control_dt / physics_dt)
    if count < 1 or abs(count * physics_dt - control_dt) > 1e-9:
        raise ConfigError(f"physics_dt {physics_dt} s does not divide control_dt {control_dt} s")
    return count


class World:
    """A simulated robot. Use one per thread.

    The steps ``physics_dt``, which must divide ``control_dt``, and ``control_dt``, for which a
    position target is held [s], are the robot's own if not given; otherwise ConfigError.
    ``suspended`` fixes a free base in the air.
    """

    def __init__(
        self,
        robot: Robot,
        physics_dt: float | None = None,
        suspended: bool = False,
        control_dt: float | None = None,
    ):
        self.robot = robot
        self.is_fixed = suspended or robot.base == "fixed"
        self.physics_dt = physics_dt or robot.physics_dt
        self.control_dt = control_dt or robot.control_dt
        self.substeps = substeps_of(self.control_dt, self.physics_dt)
        self._step = prepare_mujoco()
        self.model = build_model(robot, self.physics_dt, suspended)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.data = mujoco.MjData(self.model)
        self.first_joint, self.first_dof = (0, 0) if self.is_fixed else (7, 6)
        self._nominal_conditions = nominal_conditions(robot)
        self._feet = np.array([self.model.geom(leg.foot).id for leg in robot.legs], np.int64)
        self._applied = self._nominal_conditions
        self._nominal = {name: getattr(self.model, name).copy() for name in _RANDOMIZED}

    def reset(
        self,
        actuator: Actuator,
        joint_pos: np.ndarray | None = None,
        conditions: EpisodeConditions | None = None,
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
        damping = self.model.dof_damping[self.first_dof :]
        damping[:] = conditions.strength * actuator.damping + conditions.damping
        rows = int(np.ceil(2.0 * MAX_DELAY / self.control_dt)) + 1  # delay and jitter
        self.arrays = WorldArrays(
            step=self._step,
            model=self.model._address,
            data=self.data._address,
            qpos=self.data.qpos,
            qvel=self.data.qvel,
            applied=self.data.qfrc_applied,
            damping=damping,
            passive=conditions.damping,
            strength=conditions.strength,
            torque=np.zeros(self.robot.num_joints),
            encoder_offset=conditions.encoder_offset,
            commands=np.tile(joint_pos, (rows, 1)),
            clock=np.zeros(1, np.int64),
            delays=conditions.delay_steps(self.physics_dt),
            geoms=self.data.geom_xpos,
            feet=self._feet,
            warnings=self.data.warning.number,
            push=conditions.push,
            physics_dt=self.physics_dt,
            substeps=self.substeps,
        )
        self.data.qpos[self.first_joint :] = joint_pos
        self._motors = actuator.arrays(self.physics_dt)
        reset_actuator(
            self._motors, np.ascontiguousarray(joint_pos), np.ascontiguousarray(joint_pos)
        )
        return self._motors

    def _apply(self, conditions: EpisodeConditions) -> None:
        """Write masses, friction and gravity of these conditions into the model, without compiling it again."""
        names = "mass", "com", "gravity", "friction"
        if all(
            np.array_equal(getattr(conditions, name), getattr(self._applied, name))
            for name in names
        ):
            return
        self._applied = conditions
        for name, value in self._nominal.items():
            getattr(self.model, name)[:] = value
        # body 0 is the world
        model = self.model
        links = slice(1, None)
        model.body_mass[links] *= conditions.mass
        model.body_inertia[links] *= conditions.mass[:, None]
        model.body_ipos[1] += conditions.com
        model.pair_friction[:, :2] *= conditions.friction
        model.opt.gravity[:] = conditions.gravity
        # as when the model was compiled: the result must not depend on earlier motors
        model.dof_armature[:] = 0.0
        mujoco.mj_setConst(model, self.data)  # update the constants that MuJoCo derives from masses

    def step(self, target: np.ndarray) -> RobotState:
        """Hold (joints,) targets [rad], finite float64, for one control step (`hold_target`); then as `state`."""
        return self.state(hold_target(self.arrays, self._motors, target))

    def state(self, torque_squared_sum: float = 0.0) -> RobotState:
        """State of a free robot, a copy; see `read_state`."""
        measured = np.zeros(self.robot.num_joints)
        feet = np.zeros((len(self.robot.legs), 3))
        found = read_state(self.arrays, self._motors, torque_squared_sum, measured, feet)
        base = (
            found.base_pos.copy(),
            found.base_quat.copy(),
            found.base_lin_vel.copy(),
            found.base_ang_vel.copy(),
        )
        return RobotState(*base, measured, feet, torque_squared_sum, found.fault)

    def close(self) -> None:
        """Nothing to close."""


FAULTS = {
    1: "a coordinate, speed or acceleration is too large or not finite",
    2: "MuJoCo ran out of contact or constraint memory",
    3: "the robot's mass matrix is singular: a link without inertia",
}  # by fault number of `RobotState`
# remedy of a fault
TOO_STIFF = "the motors are too stiff or too strong for the physics step: use smaller gains"
# Beyond these a simulation counts as diverged; a physics step too long for the motors' gains
# exceeds them by far. of the base [m], [m/s]; of base and joints [rad/s]
MAX_POSITION = 1e3
MAX_SPEED = 1e2
MAX_ANGULAR_SPEED = 1e3
_WARNING = mujoco.mjtWarning
_FULL = (int(_WARNING.mjWARN_CONTACTFULL), int(_WARNING.mjWARN_CNSTRFULL))
_SINGULAR = int(_WARNING.mjWARN_INERTIA)
_BAD = (int(_WARNING.mjWARN_BADQPOS), int(_WARNING.mjWARN_BADQVEL), int(_WARNING.mjWARN_BADQACC))


class WorldArrays(NamedTuple):
    """Addresses and views of one MjModel and MjData, for compiled code."""

    step: int
    model: int
    data: int
    qpos: np.ndarray
    qvel: np.ndarray
    applied: np.ndarray  # (nv,) generalized force, the joints last
    damping: np.ndarray  # (joints,) implicit damping of the joints in the model [N·m·s/rad], a view
    passive: np.ndarray  # (joints,) damping in addition to that of the motors [N·m·s/rad]
    strength: np.ndarray  # (joints,) factors on torque and damping of the motors
    torque: np.ndarray  # (joints,) of the last physics step [N·m]
    encoder_offset: np.ndarray  # (joints,) reading of the encoders at true zero [rad]
    # (rows, joints) delay line of position targets, in true angles [rad]; state
    commands: np.ndarray
    clock: np.ndarray  # (1,) int64: control steps since reset; state
    # (steps,) or (1,) int64: age of the targets in each control step [physics steps]
    delays: np.ndarray
    geoms: np.ndarray  # (geoms, 3) positions at the beginning of the last physics step [m], a view
    feet: np.ndarray  # (legs,) int64: indices of the feet's geoms
    warnings: np.ndarray  # (kinds of warning,) int32: number of MuJoCo's warnings since the reset
    # (steps, 2) horizontal force on the chassis in each control step [N], or (0, 2)
    push: np.ndarray
    physics_dt: float
    substeps: int


@njit(cache=True, nogil=True, inline="always")
def physics_step(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """One physics step towards (joints,) targets; returns Σ torque² over the joints [(N·m)²].

    Writes the motors' torque on the joints, including the damping that the engine integrates, to
    ``world.torque``.
    """
    total = 0.0
    n = target.shape[0]
    q = world.qpos[world.qpos.shape[0] - n :]
    dq = world.qvel[world.qvel.shape[0] - n :]
    applied = world.applied[world.applied.shape[0] - n :]
    step_actuator(motors, world.physics_dt, target, q, dq, world.torque)
    for joint in range(n):
        world.torque[joint] *= world.strength[joint]
        applied[joint] = world.torque[joint]
        world.damping[joint] = world.strength[joint] * motors.damping[joint] + world.passive[joint]
    mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]
    for joint in range(n):
        world.torque[joint] -= world.strength[joint] * motors.damping[joint] * dq[joint]
        total += world.torque[joint] * world.torque[joint]
    return total


@njit(cache=True, nogil=True, inline="always")
def control_steps_late(delays: np.ndarray, step: int, substep: int, substeps: int) -> int:
    """Age in control steps of the newest target that has arrived, ``substep`` physics steps after step ``step``.

    ``delays`` (steps,) or (1,) is the delay of the target of every control step [physics steps].
    """
    late = 0
    while late <= step and delays[(step - late) % delays.shape[0]] > late * substeps + substep:
        late += 1
    return late


@njit(cache=True, nogil=True, inline="always")
def hold_target(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """Hold (joints,) targets for one control step; returns Σ torque², mean over the physics steps [(N·m)²].

    The motors get the targets after ``world.delays``, in the angles of their encoders; a push acts
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
        total += physics_step(
            world, motors, world.commands[row_of_age(world.commands, 0, newest, late)]
        )
    world.clock[0] = step + 1
    return total / world.substeps


@njit(cache=True, nogil=True)
def has_diverged(qpos: np.ndarray, qvel: np.ndarray) -> bool:
    """Whether a state (qpos, qvel of MuJoCo) is not finite or beyond the limits: fault 1, in every engine."""
    free = qpos.shape[0] > qvel.shape[0]
    for index in range(qpos.shape[0]):
        if not np.isfinite(qpos[index]) or (free and index < 3 and abs(qpos[index]) > MAX_POSITION):
            return True
    for index in range(qvel.shape[0]):
        largest = MAX_SPEED if free and index < 3 else MAX_ANGULAR_SPEED
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
    if has_diverged(world.qpos, world.qvel):
        return 1
    return 3 if world.warnings[_SINGULAR] > 0 else 0  # a diverged state makes it singular too


@njit(cache=True, nogil=True, inline="always")
def read_joints(world: WorldArrays, motors: ActuatorArrays, out: np.ndarray) -> None:
    """Write (joints,) joint angles [rad] at the encoders."""
    measure_joint_pos(motors, world.qpos[world.qpos.shape[0] - out.shape[0] :], out)
    for joint in range(out.shape[0]):
        out[joint] += world.encoder_offset[joint]


@njit(cache=True, nogil=True, inline="always")
def read_state(
    world: WorldArrays,
    motors: ActuatorArrays,
    torque_squared_sum: float,
    measured: np.ndarray,
    feet: np.ndarray,
) -> RobotState:
    """State of a free robot: views of the engine's memory, and the scratch ``measured`` (joints,), ``feet`` (legs, 3).

    ``torque_squared_sum`` is that of `hold_target`.
    """
    qpos = world.qpos
    qvel = world.qvel
    read_joints(world, motors, measured)
    for leg in range(feet.shape[0]):
        feet[leg] = world.geoms[world.feet[leg]]
    fault = find_fault(world)
    return RobotState(
        qpos[:3], qpos[3:7], qvel[:3], qvel[3:6], measured, feet, torque_squared_sum, fault
    )


# links libmujoco, whose symbols resolve through it
_LIBRARY = ctypes.CDLL(mujoco._functions.__file__)


def prepare_mujoco() -> int:
    """Address of libmujoco's ``mj_step``; changes MuJoCo in the whole process.

    Warnings are only counted (``mjData.warning``). Profiling timers stop: the Python bindings set a
    clock whose readings are a tenth of the time of ``mj_step`` (docs/engines.md), and
    ``mujoco.set_mjcb_time`` cannot remove it. A fatal error ends the process with one line: called
    by address, MuJoCo cannot raise an exception, and ``mju_error`` must not return, as MuJoCo would
    continue with an invalid state.
    """
    # or MuJoCo writes MUJOCO_LOG.TXT; the state shows faults
    mujoco.set_mju_user_warning(lambda _: None)
    ctypes.c_void_p.in_dll(_LIBRARY, "mjcb_time").value = None
    ending = ctypes.cast(_end_process, ctypes.c_void_p).value
    ctypes.c_void_p.in_dll(_LIBRARY, "mju_user_error").value = ending
    return ctypes.cast(_LIBRARY.mj_step, ctypes.c_void_p).value or 0


@ctypes.CFUNCTYPE(None, ctypes.c_char_p)
def _end_process(message: bytes) -> None:
    problem = " ".join(message.decode(errors="replace").split())
    sys.stderr.write(
        f"\nerror: MuJoCo stopped: {problem} -> run again: training resumes from its checkpoint\n"
    )
    sys.stderr.flush()
    os._exit(2)


@intrinsic
def mj_step(typingctx, function, model, data):  # pyright: ignore  # compiled signature below
    """Advance one physics step; all three arguments are integer addresses."""
    signature = types.void(types.intp, types.intp, types.intp)

    def codegen(context, builder, signature, arguments):
        address, *pointers = arguments
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, pointer])
        call = builder.inttoptr(address, kind.as_pointer())
        builder.call(call, [builder.inttoptr(value, pointer) for value in pointers])
        return context.get_dummy_value()

    return signature, codegen
