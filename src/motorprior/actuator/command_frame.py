"""Command frames of motors in MIT mode, which compiled code reads beside the position target.

    control torque = kp·(position_target - angle) + kd·(velocity_target - velocity)
                     + torque_feedforward

A frame also has the gains in force, as factors on the gains of the motors. Velocity control has the
kp factor 0. Torque control has both factors 0.

`ActuatorArrays.frames` is (2 + steps, 4·n): the frame that is sent, the frame in force, and a delay
line. Quantity k of motor i is in column k·n + i. Without rows, the motors get position commands at
constant gains.
"""

from typing import Any, NamedTuple

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.kernels import ActuatorKind
from motorprior.bounds import require_array
from motorprior.compiled import njit
from motorprior.delay_line import held, interpolated, row_of_age, write_line
from motorprior.exceptions import ConfigError

VELOCITY_TARGET, FEEDFORWARD, KP_FACTOR, KD_FACTOR = range(4)  # quantities
QUANTITIES = 4
SENT, IN_FORCE, LINE = range(3)  # rows; the delay line follows


class Frames(NamedTuple):
    """Command frames besides the position target: numbers, (n,), or (steps, n) of `Trial`."""

    velocity_target: Any = 0.0  # [rad/s]
    torque_feedforward: Any = 0.0  # [N·m]
    kp_factor: Any = 1.0  # kp in force over the motors' kp [-]
    kd_factor: Any = 1.0  # kd in force over the motors' kd [-]


POSITION = Frames()  # a position command at the motors' gains


def framed_arrays(actuator: Actuator, physics_dt: float) -> ActuatorArrays:
    """`Actuator.arrays` of motors that get command frames; raises errors as `with_frames`."""
    return with_frames(actuator.kind, actuator.arrays(physics_dt))


def with_frames(kind: ActuatorKind, arrays: ActuatorArrays) -> ActuatorArrays:
    """The arrays of motors of this kind with command frames, which were POSITION so far.

    Raises:
        ConfigError: motors of this kind take position commands only.
    """
    if not kind.takes_frames:
        raise ConfigError(
            f"motors of the model {kind.name!r} ({kind.title}) take position commands only",
            remedy="use a grey box or a PD, or command positions",
        )
    # the memory includes the motors' own delay line, so a line of this length is long enough
    rows = LINE + arrays.memory.shape[0]
    frame = np.repeat(POSITION, arrays.memory.shape[1])
    return arrays._replace(frames=np.tile(frame, (rows, 1)))


def send_frame(frames: np.ndarray, command: Frames, num_motors: int) -> None:
    """Write a command, of which all values are numbers or (n,), into ``frames``.

    Raises `ConfigError` for another shape or non-finite values.
    """
    sent = frames[SENT].reshape(QUANTITIES, num_motors)
    for row, name in enumerate(Frames._fields):
        value = np.broadcast_to(getattr(command, name), (num_motors,))
        sent[row] = require_array(name, value, (num_motors,))


@njit(cache=True, nogil=True)
def delay_frames(frames: np.ndarray, now: int, delay: np.ndarray, shift: float) -> None:
    """Write the frame in force: the frame sent ``delay`` (n,) + ``shift`` steps ago.

    It is interpolated linearly between two steps; the velocity target as `mean_target`.
    """
    newest = write_line(frames, LINE, now, frames[SENT])
    num_motors = delay.shape[0]
    for column in range(frames.shape[1]):
        age = float(delay[column % num_motors]) + shift
        frames[IN_FORCE, column] = interpolated(frames, LINE, newest, age, column)
    for motor in range(num_motors):
        age = delay[motor] + shift
        frames[IN_FORCE, motor] = mean_target(frames, LINE, frames, now, age, motor, KD_FACTOR)


@njit(cache=True, nogil=True)
def mean_target(
    memory: np.ndarray,
    first: int,
    frames: np.ndarray,
    now: int,
    age: float,
    motor: int,
    gain: int,
) -> float:
    """The target ``age`` steps ago, whose product with the mean gain is the mean of the products.

    The target's delay line begins in row ``first`` of the memory; ``gain`` is KP_FACTOR or
    KD_FACTOR. A target has no effect while its gain is 0.
    """
    newest = now % (memory.shape[0] - first)
    target = interpolated(memory, first, newest, age, motor)
    column = gain * (frames.shape[1] // QUANTITIES) + motor
    newest_frame = now % (frames.shape[0] - LINE)
    steps = int(age)
    newer_gain = frames[row_of_age(frames, LINE, newest_frame, steps), column]
    older_gain = frames[row_of_age(frames, LINE, newest_frame, steps + 1), column]
    if newer_gain == older_gain:
        return target

    share = age - steps  # of the older command
    newer = (1.0 - share) * newer_gain
    older = share * older_gain
    if newer + older == 0.0:
        return target
    newer_target = memory[row_of_age(memory, first, newest, steps), motor]
    older_target = memory[row_of_age(memory, first, newest, steps + 1), motor]
    return (newer * newer_target + older * older_target) / (newer + older)


@njit(cache=True, nogil=True, inline="always")
def held_quantity(frames, newest, age, quantity, motor, num_motors):
    """The last value of a quantity that was sent at least ``age`` steps ago."""
    return held(frames, LINE, newest, age, quantity * num_motors + motor)
