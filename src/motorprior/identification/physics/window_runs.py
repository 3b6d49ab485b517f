"""Closed-loop simulation of many motors over the windows of a log, compiled.

Its errors are the residuals of a motor's fit. It is the counterpart of the rollout in `objectives`
for searches: thousands of motors at once, and derivatives by differences.

An observer, a second simulation of every motor, follows the recorded joint through the whole
segment. Every free run starts from the observer's hidden state (rotor, backlash, delayed commands)
and the recorded joint.

Positions are compared with the raw readings: smoothed angles begin to move before the motor, so
delays fitted to them are too short. If the readings are noisy, velocity errors are differences of
position errors.

If the encoders are on the rotors, the observer's rotor follows the recording, and the joint is
attached to it. Such a log identifies neither backlash nor encoder zero: the backlash is the central
motor's, and the encoder zero is 0.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.command_frame import SENT, framed_arrays
from motorprior.actuator.geared_motor_step import StepConstants
from motorprior.actuator.grey_box import (
    ROTOR_POS,
    ROTOR_VEL,
    GreyBox,
    GreyBoxActuator,
    hidden_twist_of,
)
from motorprior.actuator.ideal_pd import GainScaledPd
from motorprior.actuator.kernels import reset_actuator, step_actuator, without_refcounts
from motorprior.actuator.optional_terms import OperatingConditions
from motorprior.bench.dynamometer import step_joints
from motorprior.compiled import njit
from motorprior.identification import windows as channel
from motorprior.identification.presets import Recipe
from motorprior.identification.search import CORES, threads
from motorprior.identification.windows import TrainingData, training_data
from motorprior.logs.motor_log import MotorLog

# errors at which the rollout loss changes from quadratic to linear
POSITION_SCALE = 0.01  # [rad]
VELOCITY_SCALE = 0.3  # [rad/s]
_TORQUE_SCALE = 0.3  # [N·m]
_TORQUE_SHARE = 0.5  # minimum scale of torque errors in a fit, relative to the RMS of the torques
SCALES = (POSITION_SCALE, VELOCITY_SCALE, _TORQUE_SCALE)
SPEED_LIMITS = ("profile_speed", "no_load_speed")
# maximum number of lanes that one thread simulates at a time; their state then stays in a core's
# cache
LANES_PER_TASK = 256
# constants that an encoder on the rotor does not identify
HIDDEN_FROM_ROTOR = ("backlash", "encoder_zero")
# rows of a grey box's parameters
_BACKLASH = StepConstants._fields.index("half_backlash")
_ZERO = StepConstants._fields.index("encoder_zero")


def sustained_speed(vel: np.ndarray, error: np.ndarray, period: float) -> np.ndarray:
    """(M,) largest speed [rad/s] that each joint kept for 0.1 s towards its target, 0 if none.

    Velocities ``vel`` and position errors ``error`` are (M, R).
    """
    from scipy.ndimage import minimum_filter1d  # here: it takes half a second to import

    rows = max(1, round(0.1 / period))
    sustained = []
    for sign in (1.0, -1.0):
        towards = np.where(sign * error > 0.0, np.maximum(sign * vel, 0.0), 0.0)
        sustained.append(minimum_filter1d(towards, rows, axis=1, mode="constant", cval=0.0))
    return np.max(sustained, axis=(0, 2)).astype(np.float64)


@njit(cache=True, nogil=True)
def _send_frame(frames: np.ndarray, row: np.ndarray, motor: np.ndarray) -> None:
    """Send the command of a row (channels of `windows`, motors) to lanes of these motors."""
    lanes = motor.shape[0]
    for quantity in range(channel.FRAME_CHANNELS):
        for lane in range(lanes):
            value = row[channel.CHANNELS + quantity, motor[lane]]
            frames[SENT, quantity * lanes + lane] = value


@njit(cache=True, nogil=True)
def _free_runs(
    observer, free, motor, rows, armature, dt, first, window, at_rotor, velocity_steps, out
):
    """Fill out (lanes, windows, channels, window) with scaled errors, simulated minus recorded.

    ``observer`` and ``free`` are the same motors, whose ``armature`` [kg·m²] (lanes,) adds to the
    load. Lane i simulates motor[i] of ``rows`` (steps, channels of `windows`, motors) of one
    segment, whose first window begins at row ``first``. ``velocity_steps`` are those of
    `TrainingData`. Rows with `windows.FRAME_CHANNELS` need motors with frames.
    """
    observer = without_refcounts(observer)
    free = without_refcounts(free)
    rows = without_refcounts(rows)
    lanes = out.shape[0]
    windows = out.shape[1]
    channels = out.shape[2]

    # inputs of one step, (lanes,)
    target = rows[0, channel.TARGET][motor]
    external = np.zeros(lanes)
    stiffness = np.zeros(lanes)
    inertia = rows[0, channel.INERTIA][motor] + armature
    # outputs of one step, (lanes,)
    torque = np.zeros(lanes)
    unused = np.zeros(lanes)

    # both simulations start from the recorded joint
    pos = rows[0, channel.POS][motor]
    vel = rows[0, channel.VEL][motor]
    has_frames = rows.shape[1] > channel.CHANNELS
    if has_frames:
        _send_frame(observer.frames, rows[0], motor)
        free.frames[SENT, :] = observer.frames[SENT]
    q = pos.copy()
    dq = vel.copy()
    obs_q = pos.copy()
    obs_dq = vel.copy()
    reset_actuator(observer, target, pos)
    reset_actuator(free, target, pos)

    for step in range(first + windows * window):
        index = (step - first) // window
        within = (step - first) % window
        for lane in range(lanes):
            target[lane] = rows[step, channel.TARGET, motor[lane]]
            external[lane] = rows[step, channel.EXTERNAL, motor[lane]]
            stiffness[lane] = rows[step, channel.STIFFNESS, motor[lane]]
        if has_frames:
            _send_frame(observer.frames, rows[step], motor)

        # every window starts from the observer
        if step >= first and within == 0:
            free.memory[:] = observer.memory
            free.history[:] = observer.history
            free.frames[:] = observer.frames
            q[:] = obs_q
            dq[:] = obs_dq
        if has_frames:
            free.frames[SENT, :] = observer.frames[SENT]
        free.clock[0] = observer.clock[0]

        if at_rotor:
            step_joints(observer, dt, target, external, stiffness, inertia, obs_q, obs_dq, unused)
        else:
            step_actuator(observer, dt, target, obs_q, obs_dq, unused)
        if step >= first:
            step_joints(free, dt, target, external, stiffness, inertia, q, dq, torque)

        for lane in range(lanes):
            j = motor[lane]
            next_pos = rows[step + 1, channel.POS, j]
            next_vel = rows[step + 1, channel.VEL, j]
            reading = rows[step + 1, channel.READING, j]

            # the observer follows the recording, at the encoder's side of the gear
            if at_rotor:
                rotor = next_pos + hidden_twist_of(observer, lane, obs_q[lane])
                observer.memory[ROTOR_POS, lane] = rotor
                observer.memory[ROTOR_VEL, lane] = next_vel
            else:
                obs_q[lane] = next_pos
                obs_dq[lane] = next_vel

            # during the warm-up there is nothing to compare
            if step < first:
                continue

            # compare what the encoder reads
            encoder_pos = q[lane]
            encoder_vel = dq[lane]
            if at_rotor:
                encoder_pos = free.memory[ROTOR_POS, lane] - hidden_twist_of(free, lane, q[lane])
                encoder_vel = free.memory[ROTOR_VEL, lane]
            out[lane, index, 0, within] = (encoder_pos - reading) / SCALES[0]

            # noisy readings: the velocity error is the change of the position error
            if velocity_steps == 0:
                out[lane, index, 1, within] = (encoder_vel - next_vel) / SCALES[1]
            else:
                earlier_error = 0.0
                if within >= velocity_steps:
                    earlier_error = out[lane, index, 0, within - velocity_steps]
                change = (out[lane, index, 0, within] - earlier_error) * SCALES[0]
                out[lane, index, 1, within] = change / (velocity_steps * dt * SCALES[1])

            if channels > 2:
                applied = torque[lane] - free.damping[lane] * dq[lane]
                out[lane, index, 2, within] = (applied - rows[step, channel.TORQUE, j]) / SCALES[2]


@dataclass(frozen=True)
class SegmentArrays:
    """One segment of the logs of M motors."""

    rows: np.ndarray  # (steps, channels, M)
    windows: int  # number of whole windows

    @property
    def seconds(self) -> float:
        """Mean time since the log began [s]."""
        return float(self.rows[:, channel.SECONDS, 0].mean())

    @property
    def gains(self) -> np.ndarray:
        """(2, M) logged kp and kd."""
        return self.rows[0, [channel.KP, channel.KD]]

    @property
    def acting(self) -> np.ndarray:
        """(2, M) whether kp and kd act in any row."""
        if not self.has_frames:
            return np.ones_like(self.gains, dtype=bool)
        return np.any(self.rows[:, [channel.KP_FACTOR, channel.KD_FACTOR]], axis=0)

    @property
    def has_frames(self) -> bool:
        """Whether the rows have the command frames of `windows.FRAME_CHANNELS`."""
        return self.rows.shape[1] > channel.CHANNELS

    @property
    def max_request(self) -> np.ndarray:
        """(steps, M) magnitude of the commanded torque over the logged kp [rad].

        It is the position error for position commands. In other modes, it also has the feed-forward
        torque and kd times the velocity error, over the logged kp; a gain that is not logged counts
        as 1 N·m/rad, or 1 N·m·s/rad.
        """
        error = self.rows[:, channel.TARGET] - self.rows[:, channel.POS]
        if not self.has_frames:
            return np.abs(error)
        kp, kd = self.gains
        vel_error = self.rows[:, channel.VELOCITY_TARGET] - self.rows[:, channel.VEL]
        torque = (
            self.rows[:, channel.KP_FACTOR] * kp * error
            + self.rows[:, channel.KD_FACTOR] * kd * vel_error
            + self.rows[:, channel.FEEDFORWARD]
        )
        return np.abs(torque) / kp

    @property
    def operating_conditions(self) -> np.ndarray:
        """(2, M) supply voltage over the nominal one [-], and temperature above it [K]."""
        return self.rows[0, [channel.SUPPLY, channel.TEMPERATURE_RISE]]


# motors of a log on its loads, at the gains of its segments
TorqueMotors: TypeAlias = Actuator | GainScaledPd
# (unknowns (L, K), motor (L,) of the log, segment) -> L motors
MotorsOf: TypeAlias = Callable[[np.ndarray, np.ndarray, SegmentArrays], Actuator]


class WindowRuns:
    """Free runs over all windows of M motors' logs, or of those with the indices ``motors``.

    Attributes:
        recipe: with window and warm-up of the free runs.
        segments: segments of the logs that have at least one window.
        num_motors: M.
        at_rotor: whether the log's encoders are on the rotors.
        command_mode: command mode of the log.
        logs_kd: whether the log states kd.
        channels: errors per sample: of position, velocity and, if measured, torque.
        max_speed: speed [rad/s] that the fastest joint exceeds in one row of a thousand of the
            whole log.
        classes: (M,) index of the motor's class of joints.
        motor_models: motor model of each motor; none if the log states none.
        sustained_speeds: (M,) `sustained_speed` in the log for each of SPEED_LIMITS; for
            no_load_speed, at the nominal voltage.
        counted: (N,) indices of the windows whose errors count as residuals.
    """

    def __init__(self, data: TrainingData, recipe: Recipe, motors: np.ndarray | None = None):
        series = data.series if motors is None else data.series[motors]
        self.recipe = recipe
        self.num_motors = len(series)
        self.at_rotor = data.at_rotor
        self.channels = 3 if data.has_torque else 2
        self.command_mode = data.command_mode
        self.logs_kd = data.logs_kd
        self._velocity_steps = data.velocity_steps

        self.segments = []
        for segment in data.segments:
            windows = (segment.stop - segment.start - 1 - recipe.history) // recipe.window
            if windows > 0:
                rows = np.ascontiguousarray(series[:, segment].transpose(1, 2, 0), np.float64)
                self.segments.append(SegmentArrays(rows, windows))
        self.counted = np.arange(self.windows)

        indices = np.arange(len(data.series)) if motors is None else motors
        names = [data.joint_classes[motor] if data.joint_classes else "" for motor in indices]
        self.classes = np.unique(names, return_inverse=True)[1]
        models = data.motor_models
        self.motor_models = tuple(models[motor] for motor in indices if models)

        # (M, R) of the whole log
        velocity = series[..., channel.VEL]
        error = series[..., channel.TARGET] - series[..., channel.POS]
        self.max_speed = float(np.quantile(np.abs(velocity), 0.999, axis=1).max())
        # a profile limits the speed; the no-load speed is proportional to the supply voltage
        speeds = (velocity, velocity / series[..., channel.SUPPLY])
        # A torque error counts relative to the torques of its motor: at the scale of a small motor,
        # the torque column of a large one would outweigh its angles.
        rms_torque = np.sqrt(np.mean(series[..., channel.TORQUE].astype(np.float64) ** 2, axis=1))
        torque_scale = np.maximum(_TORQUE_SCALE, _TORQUE_SHARE * rms_torque)
        self._torque_factor = _TORQUE_SCALE / torque_scale
        self.sustained_speeds = {
            name: sustained_speed(speed, error, recipe.period)
            for name, speed in zip(SPEED_LIMITS, speeds, strict=True)
        }

    @property
    def windows(self) -> int:
        """Number of windows of each motor."""
        return sum(segment.windows for segment in self.segments)

    @property
    def gains(self) -> np.ndarray:
        """(2, M) logged kp and kd of every motor, medians over segments; 1 if there are none.

        Segments without position control do not count for kp, if others have it; likewise for kd.
        """
        gains = np.array([segment.gains for segment in self.segments])
        acting = np.array([segment.acting for segment in self.segments])
        counted = acting | ~acting.any(axis=0)
        return np.ma.median(np.ma.array(gains, mask=~counted), axis=0).filled(1.0)

    @property
    def max_request(self) -> np.ndarray:
        """(M,) 99.9 % quantile of logged kp times position error [rad], or of torque commands."""
        requests = [segment.max_request * segment.gains[0] for segment in self.segments]
        return np.quantile(np.concatenate(requests), 0.999, axis=0)

    def counting(self, windows: np.ndarray) -> "WindowRuns":
        """The same runs, of which only these ``windows`` (N,), a mask, count as residuals."""
        runs = copy.copy(self)
        runs.counted = np.flatnonzero(windows)
        return runs

    def segment_indices(self) -> np.ndarray:
        """(N,) index of the segment of each window."""
        windows = [segment.windows for segment in self.segments]
        return np.repeat(np.arange(len(self.segments)), windows)

    def residuals(self, motors_of: MotorsOf, x: np.ndarray, motor: np.ndarray) -> np.ndarray:
        """(L, N, C, W) scaled errors of motor ``motor[l]`` with unknowns x[l], float32.

        Only the N counted windows are returned.
        """
        lanes = len(motor)
        # tasks of one segment: enough for all cores, and multiples of eight lanes
        tasks_per_segment = max(1, -(-CORES // len(self.segments)))
        lanes_per_task = min(LANES_PER_TASK, 8 * -(-lanes // (8 * tasks_per_segment)))
        tasks = []
        first_window = 0
        for segment in self.segments:
            windows = slice(first_window, first_window + segment.windows)
            first_window = windows.stop
            for first in range(0, lanes, lanes_per_task):
                tasks.append((slice(first, min(first + lanes_per_task, lanes)), windows, segment))

        out = np.empty((lanes, self.windows, self.channels, self.recipe.window), np.float32)

        def simulate(task: tuple[slice, slice, SegmentArrays]) -> None:
            task_lanes, windows, segment = task
            motors = motors_of(x[task_lanes], motor[task_lanes], segment)
            out[task_lanes, windows] = self.run(motors, motor[task_lanes], segment)

        list(threads().map(simulate, tasks))
        if self.channels > 2:
            out[:, :, 2] *= self._torque_factor[motor, None, None]
        return out if len(self.counted) == self.windows else out[:, self.counted]

    def recorded(self, index: int) -> np.ndarray:
        """(M, N, W) recorded values of channel ``index`` of `windows` at the end of every step."""
        window = self.recipe.window
        first = self.recipe.history + 1
        values = []
        for segment in self.segments:
            rows = segment.rows[first : first + segment.windows * window, index]
            values.append(rows.T.reshape(self.num_motors, segment.windows, window))
        return np.concatenate(values, axis=1)

    def errors(self, motors: TorqueMotors) -> np.ndarray:
        """(M, N, C, W) scaled errors of any motors, one for each of the log; float32.

        Grey boxes and a `GainScaledPd` get the gains of each segment. Angles of the joint are
        compared, or for grey boxes angles of the rotor if the log's encoders are on it.
        """
        motor = np.arange(self.num_motors)

        def errors_in(segment: SegmentArrays) -> np.ndarray:
            actuator = motors.at(segment.gains) if isinstance(motors, GainScaledPd) else motors
            if isinstance(actuator, GreyBoxActuator):
                actuator = grey_boxes(actuator.model)(actuator.z, motor, segment)
            return self.run(actuator, motor, segment)

        return np.concatenate(list(threads().map(errors_in, self.segments)), axis=1)

    def run(self, motors: Actuator, motor: np.ndarray, segment: SegmentArrays) -> np.ndarray:
        """(L, windows, C, W) scaled errors of L motors in a segment.

        The motors replay the rows of the log's motors with the indices ``motor`` (L,).
        """
        recipe = self.recipe
        new_arrays = framed_arrays if segment.has_frames else _arrays
        observer = new_arrays(motors, recipe.period)
        free = new_arrays(motors, recipe.period)

        at_rotor = self.at_rotor and isinstance(motors, GreyBoxActuator)
        if self.at_rotor and isinstance(motors, GreyBoxActuator):
            # the encoder hides these constants: backlash of the central motor, no encoder zero
            mean = np.zeros((1, motors.z.shape[1]))
            central = motors.model.motors(mean, gains=segment.gains[:, :1]).arrays(recipe.period)
            for arrays in (observer, free):
                arrays.parameters[_BACKLASH] = central.parameters[_BACKLASH, 0]
                arrays.parameters[_ZERO] = 0.0

        out = np.empty((len(motor), segment.windows, self.channels, recipe.window), np.float32)
        _free_runs(
            observer,
            free,
            motor,
            segment.rows,
            motors.armature,
            recipe.period,
            recipe.history,
            recipe.window,
            at_rotor,
            self._velocity_steps,
            out,
        )
        return out


def _arrays(motors: Actuator, period: float) -> ActuatorArrays:
    return motors.arrays(period)


def grey_boxes(model: GreyBox) -> MotorsOf:
    """Motors of latents, at the gains and under the operating conditions of the segment."""

    def motors(z: np.ndarray, motor: np.ndarray, segment: SegmentArrays) -> GreyBoxActuator:
        gains = segment.gains[:, motor] if model.gain_unit else None
        warmth = model.warmth(z, segment.seconds)
        supply, temperature_rise = segment.operating_conditions[:, motor]
        return model.motors(z, OperatingConditions(warmth, supply, temperature_rise), gains)

    return motors


def with_gain_unit_of(recipe: Recipe, log: MotorLog) -> Recipe:
    """The recipe with the gain unit of the log, for PDs that scale with logged gains.

    The recipe stays the same if it already has a unit, or if the log has no gains.
    """
    if log.gains is None or recipe.gain_unit:
        return recipe
    return replace(recipe, gain_unit=log.gain_unit)


def whole_runs(log: MotorLog, recipe: Recipe) -> list[WindowRuns]:
    """One free run per segment of the log, without the recipe's warm-up; raises `LogError`.

    Segments that are no longer than the warm-up are left out. Simulated angles are compared with
    smoothed angles, since the readings of many robots have late time stamps.
    """
    recipe = replace(with_gain_unit_of(recipe, log), objective="rollout", window=1)
    data = training_data(log, recipe, log.source)
    data.series[..., channel.READING] = data.series[..., channel.POS]

    runs = []
    for segment in data.segments:
        window = segment.stop - segment.start - 1 - recipe.history
        if window > 0:
            one_segment = replace(data, segments=(segment,), velocity_steps=0)
            runs.append(WindowRuns(one_segment, replace(recipe, window=window)))
    return runs
