"""Closed-loop simulation of many motors over the windows of a log, compiled: the residuals of a motor's fit.

The counterpart of the rollout in `objectives` for searches: thousands of motors at once,
derivatives by differences. An observer, a second simulation of every motor, follows the recorded
joint through the whole segment. Every free run starts from the observer's hidden state (rotor,
backlash, delayed commands) and the recorded joint.

Position errors are those of the raw readings: smoothed angles begin to move before the motor, so
delays fitted to them are too short. If the readings are noisy, velocity errors are differences of
position errors.

If the encoders are on the rotors, the observer's rotor follows the recording, and the joint is
attached to it. Such a log identifies neither backlash nor encoder zero: the former is the central
motor's, the latter 0.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.geared_motor_step import StepConstants
from motorprior.actuator.grey_box import ROTOR_POS, ROTOR_VEL, GreyBox, GreyBoxActuator, added_twist
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

# errors at which the rollout loss changes from quadratic to linear: position [rad], velocity
# [rad/s], torque [N·m]
POSITION_SCALE, VELOCITY_SCALE, _ = SCALES = (0.01, 0.3, 0.3)
SPEED_LIMITS = ("profile_speed", "no_load_speed")
# at most, that one thread simulates at a time; their state then stays in a core's cache
LANES_PER_TASK = 256
# constants that an encoder on the rotor does not identify
HIDDEN_FROM_ROTOR = ("backlash", "encoder_zero")
# rows of a grey box's parameters
_BACKLASH, _ZERO = (StepConstants._fields.index(name) for name in ("half_backlash", "encoder_zero"))


def sustained_speed(vel: np.ndarray, error: np.ndarray, period: float) -> np.ndarray:
    """(M,) largest speed [rad/s] that each joint kept for 0.1 s towards its target, 0 if none; inputs are (M, R)."""
    from scipy.ndimage import minimum_filter1d  # here: it takes half a second to import

    rows = max(1, round(0.1 / period))
    lowest = []
    for sign in (1.0, -1.0):
        towards = np.where(sign * error > 0.0, np.maximum(sign * vel, 0.0), 0.0)
        lowest.append(minimum_filter1d(towards, rows, axis=1, mode="constant", cval=0.0))
    return np.max(lowest, axis=(0, 2)).astype(np.float64)


@njit(cache=True, nogil=True)
def _free_runs(
    observer, free, motor, rows, armature, dt, first, window, at_rotor, velocity_steps, out
):
    """Fill out (lanes, windows, channels, window) with scaled errors, simulated minus recorded.

    ``observer`` and ``free`` are the same motors, whose ``armature`` [kg·m²] (lanes,) adds to the
    load; lane i simulates motor[i] of ``rows`` (steps, channels of `windows`, motors) of one
    segment, whose first window begins at row ``first``. ``velocity_steps`` are those of
    `TrainingData`.
    """
    observer = without_refcounts(observer)
    free = without_refcounts(free)
    rows = without_refcounts(rows)
    lanes = out.shape[0]
    windows = out.shape[1]
    channels = out.shape[2]
    target = rows[0, channel.TARGET][motor]
    pos = rows[0, channel.POS][motor]
    vel = rows[0, channel.VEL][motor]
    inertia = rows[0, channel.INERTIA][motor] + armature
    torque = np.zeros(lanes)
    unused = np.zeros(lanes)
    external = np.zeros(lanes)
    stiffness = np.zeros(lanes)
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
        if step >= first and within == 0:
            free.memory[:] = observer.memory
            free.history[:] = observer.history
            q[:] = obs_q
            dq[:] = obs_dq
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
            if at_rotor:
                rotor = next_pos + added_twist(observer, lane, obs_q[lane])
                observer.memory[ROTOR_POS, lane] = rotor
                observer.memory[ROTOR_VEL, lane] = next_vel
            else:
                obs_q[lane] = next_pos
                obs_dq[lane] = next_vel
            if step < first:
                continue
            own_pos = q[lane]
            own_vel = dq[lane]
            if at_rotor:
                own_pos = free.memory[ROTOR_POS, lane] - added_twist(free, lane, q[lane])
                own_vel = free.memory[ROTOR_VEL, lane]
            out[lane, index, 0, within] = (own_pos - reading) / SCALES[0]
            if velocity_steps == 0:
                out[lane, index, 1, within] = (own_vel - next_vel) / SCALES[1]
            else:
                before = (
                    out[lane, index, 0, within - velocity_steps]
                    if within >= velocity_steps
                    else 0.0
                )
                change = (out[lane, index, 0, within] - before) * SCALES[0]
                out[lane, index, 1, within] = change / (velocity_steps * dt * SCALES[1])
            if channels > 2:
                applied = torque[lane] - free.damping[lane] * dq[lane]
                out[lane, index, 2, within] = (applied - rows[step, channel.TORQUE, j]) / SCALES[2]


@dataclass(frozen=True)
class SegmentArrays:
    """One segment: (steps, channels, M) rows, and its number of whole windows."""

    rows: np.ndarray
    windows: int

    @property
    def seconds(self) -> float:
        """Mean time since the log began [s]."""
        return float(self.rows[:, channel.SECONDS, 0].mean())

    @property
    def gains(self) -> np.ndarray:
        """(2, M) logged kp and kd."""
        return self.rows[0, [channel.KP, channel.KD]]

    @property
    def conditions(self) -> np.ndarray:
        """(2, M) supply voltage over the nominal one [-], and temperature above it [K]."""
        return self.rows[0, [channel.SUPPLY, channel.TEMPERATURE_RISE]]


# motors of a log on its loads, at the gains of its segments
MotorsOnLoads: TypeAlias = Actuator | GainScaledPd
# (unknowns (L, K), motor (L,) of the log, segment) -> L motors
MotorsOf: TypeAlias = Callable[[np.ndarray, np.ndarray, SegmentArrays], Actuator]


class WindowRuns:
    """Free runs over all windows of M motors' logs, or of those with the indices ``motors``.

    Attributes:
        at_rotor: whether the log's encoders are on the rotors.
        channels: errors per sample: of position, velocity and, if measured, torque.
        max_speed: speed [rad/s] that the fastest joint exceeds in one row of a thousand of the
            whole log.
        classes: (M,) index of the motor's class of joints.
        sustained_speeds: (M,) `sustained_speed` in the log for each of SPEED_LIMITS; for
            no_load_speed, at the nominal voltage.
    """

    def __init__(self, data: TrainingData, recipe: Recipe, motors: np.ndarray | None = None):
        series = data.series if motors is None else data.series[motors]
        self.recipe = recipe
        self.segments = []
        self.at_rotor = data.at_rotor
        self.channels = 3 if data.has_torque else 2
        self._velocity_steps = data.velocity_steps
        for part in data.parts:
            windows = (part.stop - part.start - 1 - recipe.history) // recipe.window
            if windows > 0:
                rows = np.ascontiguousarray(series[:, part].transpose(1, 2, 0), np.float64)
                self.segments.append(SegmentArrays(rows, windows))
        self.num_motors = len(series)
        chosen = np.arange(len(data.series)) if motors is None else motors
        names = [data.joint_classes[motor] if data.joint_classes else "" for motor in chosen]
        self.classes = np.unique(names, return_inverse=True)[1]
        velocity = series[..., channel.VEL]
        error = series[..., channel.TARGET] - series[..., channel.POS]
        self.max_speed = float(np.quantile(np.abs(velocity), 0.999, axis=1).max())
        speeds = (velocity, velocity / series[..., channel.SUPPLY])
        self.sustained_speeds = {
            name: sustained_speed(speed, error, recipe.period)
            for name, speed in zip(SPEED_LIMITS, speeds, strict=True)
        }
        self.counted = np.arange(self.windows)

    @property
    def windows(self) -> int:
        """Number of windows of each motor."""
        return sum(segment.windows for segment in self.segments)

    @property
    def gains(self) -> np.ndarray:
        """(2, M) logged kp and kd of every motor, medians over segments; 1 if there are none."""
        return np.median([segment.gains for segment in self.segments], axis=0)

    @property
    def max_request(self) -> np.ndarray:
        """(M,) 99.9 % quantile of logged kp times position error [rad]."""
        errors = [
            np.abs(one.rows[:, channel.TARGET] - one.rows[:, channel.POS]) for one in self.segments
        ]
        requests = [error * one.gains[0] for error, one in zip(errors, self.segments, strict=True)]
        return np.quantile(np.concatenate(requests), 0.999, axis=0)

    def chosen(self, windows: np.ndarray) -> "WindowRuns":
        """The same runs, of which only these ``windows`` (N,) count as residuals."""
        some = copy.copy(self)
        some.counted = np.flatnonzero(windows)
        return some

    def groups(self) -> np.ndarray:
        """(N,) index of the segment of each window."""
        return np.repeat(
            np.arange(len(self.segments)), [segment.windows for segment in self.segments]
        )

    def residuals(self, motors_of: MotorsOf, x: np.ndarray, motor: np.ndarray) -> np.ndarray:
        """(L, N, C, W) scaled errors of motor ``motor[l]`` with unknowns x[l], in the N counted windows; float32."""
        lanes = len(motor)
        parts = max(1, -(-CORES // len(self.segments)))
        together = min(LANES_PER_TASK, 8 * -(-lanes // (8 * parts)))
        out = np.empty((lanes, self.windows, self.channels, self.recipe.window), np.float32)
        tasks = []
        done = 0
        for segment in self.segments:
            inside = slice(done, done + segment.windows)
            for first in range(0, lanes, together):
                tasks.append((slice(first, min(first + together, lanes)), inside, segment))
            done += segment.windows

        def simulate(task: tuple[slice, slice, SegmentArrays]) -> None:
            some, inside, segment = task
            out[some, inside] = self.run(
                motors_of(x[some], motor[some], segment), motor[some], segment
            )

        list(threads().map(simulate, tasks))
        return out if len(self.counted) == self.windows else out[:, self.counted]

    def recorded(self, index: int) -> np.ndarray:
        """(M, N, W) recorded values of a channel of `windows` at the end of every step of the windows."""
        recipe = self.recipe
        found = []
        for segment in self.segments:
            first = recipe.history + 1
            rows = segment.rows[first : first + segment.windows * recipe.window, index]
            found.append(rows.T.reshape(self.num_motors, segment.windows, recipe.window))
        return np.concatenate(found, axis=1)

    def errors(self, motors: MotorsOnLoads) -> np.ndarray:
        """(M, N, C, W) scaled errors of any motors, one for each of the log; float32.

        Grey boxes and a `GainScaledPd` get the gains of each segment. Angles of the joint are
        compared, or for grey boxes those of the rotor if the log's encoders are on it.
        """
        everyone = np.arange(self.num_motors)

        def errors(segment: SegmentArrays) -> np.ndarray:
            found = motors.at(segment.gains) if isinstance(motors, GainScaledPd) else motors
            if isinstance(found, GreyBoxActuator):
                found = grey_boxes(found.model)(found.z, everyone, segment)
            return self.run(found, everyone, segment)

        return np.concatenate(list(threads().map(errors, self.segments)), axis=1)

    def run(self, motors: Actuator, motor: np.ndarray, segment: SegmentArrays) -> np.ndarray:
        """(L, windows, C, W) scaled errors of L motors in a segment, of the log's ``motor`` (L,)."""
        recipe = self.recipe
        at_rotor = False
        observer = motors.arrays(recipe.period)
        free = motors.arrays(recipe.period)
        if self.at_rotor and isinstance(motors, GreyBoxActuator):
            at_rotor = True
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


def grey_boxes(model: GreyBox) -> MotorsOf:
    """Motors of latents, at the gains and under the conditions of the segment."""

    def motors(z: np.ndarray, motor: np.ndarray, segment: SegmentArrays) -> GreyBoxActuator:
        gains = segment.gains[:, motor] if model.gain_unit else None
        conditions = OperatingConditions(
            model.warmth(z, segment.seconds), *segment.conditions[:, motor]
        )
        return model.motors(z, conditions, gains)

    return motors


def with_gains_of(recipe: Recipe, log: MotorLog) -> Recipe:
    """A recipe that reads the gains of a log, for PDs that scale with them, if the prior does not already."""
    return (
        replace(recipe, gain_unit=log.gain_unit)
        if log.logged_kp is not None and not recipe.gain_unit
        else recipe
    )


def whole_runs(log: MotorLog, recipe: Recipe) -> list[WindowRuns]:
    """Every segment of the log that is longer than the recipe's warm-up as one free run; raises `LogError`.

    Simulated angles are compared with smoothed ones: readings of many robots have late time stamps.
    """
    recipe = replace(with_gains_of(recipe, log), objective="rollout", window=1)
    data = training_data(log, recipe, log.source)
    data.series[..., channel.READING] = data.series[..., channel.POS]
    windows = [(part, part.stop - part.start - 1 - recipe.history) for part in data.parts]
    return [
        WindowRuns(replace(data, parts=(part,), velocity_steps=0), replace(recipe, window=window))
        for part, window in windows
        if window > 0
    ]
