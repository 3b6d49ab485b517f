"""One robot's steps in MuJoCo as compiled code: physics step, control step, state and faults.

The functions work on views of the engine's memory (`WorldArrays`); `world.World` makes them.
"""

from typing import NamedTuple

import mujoco
import numpy as np

from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.kernels import measure_joint_pos, step_actuator
from motorprior.compiled import njit
from motorprior.delay_line import row_of_age, write_line
from motorprior.locomotion.control_step import RobotState
from motorprior.simulation.mujoco_library import mj_step

# by fault number of `RobotState`
FAULTS = {
    1: "a coordinate, speed or acceleration is too large or not finite",
    2: "MuJoCo ran out of contact or constraint memory",
    3: "the robot's mass matrix is singular: a link without inertia",
}
# remedy of a fault
TOO_STIFF = "the motors are too stiff or too strong for the physics step: use smaller gains"

# A simulation beyond these limits counts as diverged. A simulation whose physics step is too long
# for the motors' gains exceeds them by far.
MAX_POSITION = 1e3  # maximum coordinate of the base [m]
MAX_SPEED = 1e2  # maximum speed of the base [m/s]
MAX_ANGULAR_SPEED = 1e3  # maximum angular speed of base and joints [rad/s]

# MuJoCo's warnings by the fault that they indicate
_WARNING = mujoco.mjtWarning
_OUT_OF_MEMORY = (int(_WARNING.mjWARN_CONTACTFULL), int(_WARNING.mjWARN_CNSTRFULL))
_NOT_FINITE = (
    int(_WARNING.mjWARN_BADQPOS),
    int(_WARNING.mjWARN_BADQVEL),
    int(_WARNING.mjWARN_BADQACC),
)
_SINGULAR = int(_WARNING.mjWARN_INERTIA)


class WorldArrays(NamedTuple):
    """Addresses and views of one MjModel and MjData, for compiled code."""

    step: int  # address of `mj_step`
    model: int  # address of the MjModel
    data: int  # address of the MjData
    qpos: np.ndarray  # generalized coordinates, the joints last
    qvel: np.ndarray  # (nv,) generalized velocities, the joints last
    applied: np.ndarray  # (nv,) generalized forces, the joints last
    damping: np.ndarray  # (joints,) implicit damping of the joints in the model [N·m·s/rad]
    passive_damping: np.ndarray  # (joints,) damping in addition to the motors' [N·m·s/rad]
    strength: np.ndarray  # (joints,) factors on torque and damping of the motors
    torque: np.ndarray  # (joints,) torque of the motors in the last physics step [N·m]
    encoder_offset: np.ndarray  # (joints,) reading of the encoders at true zero [rad]
    # (rows, joints) delay line of position targets, in true angles [rad]; changes with every step
    commands: np.ndarray
    clock: np.ndarray  # (1,) int64: control steps since the reset; changes with every step
    # (steps,) or (1,) int64: age of the targets in each control step [physics steps]
    delays: np.ndarray
    geoms: np.ndarray  # (geoms, 3) positions at the beginning of the last physics step [m]
    feet: np.ndarray  # (legs,) int64: indices of the feet's geoms
    warnings: np.ndarray  # int32: MuJoCo's warnings since the reset, a counter per type of warning
    # (steps, 2) horizontal force on the chassis in each control step [N], or (0, 2)
    push: np.ndarray
    physics_dt: float  # [s]
    substeps: int  # physics steps per control step


@njit(cache=True, nogil=True, inline="always")
def physics_step(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """One physics step towards (joints,) targets; returns Σ torque² over the joints [(N·m)²].

    Writes the motors' torque on the joints, including the damping that the engine integrates, to
    ``world.torque``.
    """
    n = target.shape[0]
    q = world.qpos[world.qpos.shape[0] - n :]
    dq = world.qvel[world.qvel.shape[0] - n :]
    applied = world.applied[world.applied.shape[0] - n :]

    step_actuator(motors, world.physics_dt, target, q, dq, world.torque)
    for joint in range(n):
        world.torque[joint] *= world.strength[joint]
        applied[joint] = world.torque[joint]
        motor_damping = world.strength[joint] * motors.damping[joint]
        world.damping[joint] = motor_damping + world.passive_damping[joint]

    mj_step(world.step, world.model, world.data)  # pyright: ignore[reportCallIssue]

    # the engine damps implicitly: by the velocity at the end of the step
    total = 0.0
    for joint in range(n):
        world.torque[joint] -= world.strength[joint] * motors.damping[joint] * dq[joint]
        total += world.torque[joint] * world.torque[joint]
    return total


@njit(cache=True, nogil=True, inline="always")
def control_steps_late(delays: np.ndarray, step: int, substep: int, substeps: int) -> int:
    """Age in control steps of the newest target that has arrived.

    The time is ``substep`` physics steps after the beginning of control step ``step``. ``delays``
    (steps,) or (1,) is the delay of the target of every control step [physics steps].
    """
    late = 0
    while late <= step and delays[(step - late) % delays.shape[0]] > late * substeps + substep:
        late += 1
    return late


@njit(cache=True, nogil=True, inline="always")
def hold_target(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray) -> float:
    """Hold (joints,) targets for one control step.

    The motors get the targets after ``world.delays``, in the angles of their encoders; a push acts
    on the origin of the chassis. Returns Σ torque², mean over the physics steps [(N·m)²].
    """
    step = world.clock[0]
    newest = write_line(world.commands, 0, step, target)
    for joint in range(target.shape[0]):
        world.commands[newest, joint] -= world.encoder_offset[joint]

    if world.push.shape[0] > 0:
        push = step % world.push.shape[0]
        world.applied[0] = world.push[push, 0]
        world.applied[1] = world.push[push, 1]

    total = 0.0
    for substep in range(world.substeps):
        late = control_steps_late(world.delays, step, substep, world.substeps)
        row = row_of_age(world.commands, 0, newest, late)
        total += physics_step(world, motors, world.commands[row])

    world.clock[0] = step + 1
    return total / world.substeps


@njit(cache=True, nogil=True)
def has_diverged(qpos: np.ndarray, qvel: np.ndarray) -> bool:
    """Whether MuJoCo's coordinates qpos and qvel are not finite or beyond the limits.

    This is fault 1 in every engine.
    """
    is_free = qpos.shape[0] > qvel.shape[0]

    for index in range(qpos.shape[0]):
        if not np.isfinite(qpos[index]):
            return True
        if is_free and index < 3 and abs(qpos[index]) > MAX_POSITION:
            return True

    for index in range(qvel.shape[0]):
        limit = MAX_SPEED if is_free and index < 3 else MAX_ANGULAR_SPEED
        if not abs(qvel[index]) <= limit:  # true for NaN too
            return True

    return False


@njit(cache=True, nogil=True, inline="always")
def find_fault(world: WorldArrays) -> int:
    """Key of FAULTS of the fault since the reset, or 0."""
    if world.warnings[_OUT_OF_MEMORY[0]] > 0 or world.warnings[_OUT_OF_MEMORY[1]] > 0:
        return 2
    for warning in _NOT_FINITE:
        if world.warnings[warning] > 0:
            return 1
    if has_diverged(world.qpos, world.qvel):
        return 1
    # last, since a diverged state makes the mass matrix singular too
    if world.warnings[_SINGULAR] > 0:
        return 3
    return 0


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
    """State of a robot with a free base, as views of the engine's memory and of the scratch memory.

    The scratch memory is ``measured`` (joints,) and ``feet`` (legs, 3). ``torque_squared_sum`` is
    the result of `hold_target`.
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
