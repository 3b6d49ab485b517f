"""Training data: logs as stacked arrays, and windows that never cross the end of a segment."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.exceptions import LogError
from motorprior.identification.presets import Recipe
from motorprior.logs.command_modes import gain_factors
from motorprior.logs.motor_log import MotorLog, other_firmware
from motorprior.logs.operations import with_velocities, without_noise
from motorprior.robots.motor_models import MotorModel
from motorprior.signals import rms


@dataclass(frozen=True)
class TrainingData:
    """Logs of M motors with R rows each."""

    # (M, R, CHANNELS) float32; of logs with command frames (M, R, CHANNELS + FRAME_CHANNELS). For a
    # rollout, noisy joint_pos is smoothed (`smoothing`); as in a semi-implicit step, velocities are
    # half a period older than the sample, and torques are averages centred on it
    series: np.ndarray
    # (S,) first rows of the windows that lie inside one segment
    starts: np.ndarray
    # rows of each segment
    segments: tuple[slice, ...]
    # error_scale [rad], velocity_scale [rad/s], torque_scale and torque_limit [N·m]
    scales: dict[str, float]
    # whether the log has joint_torque
    has_torque: bool
    # command mode of the log, one of `motor_log.COMMAND_MODES`
    command_mode: str = "position"
    # whether the log states kd
    logs_kd: bool = False
    # whether the encoders are on the rotors, which hides the gears' backlash, or on the joints
    at_rotor: bool = False
    # M names, or none
    joint_names: tuple[str, ...] = ()
    # M classes, or none: one class
    joint_classes: tuple[str, ...] = ()
    # M motor models, or none
    motor_models: tuple[MotorModel, ...] = ()
    # names of the joints whose commands were sent faster than they were logged
    slow_commands: tuple[str, ...] = ()
    # steps over which changes of the joint_reading error are velocity errors; 0: velocities are
    # compared
    velocity_steps: int = 0


CHANNELS = 13
(
    TARGET,  # position_target [rad]
    POS,  # joint_pos [rad]
    VEL,  # joint_vel [rad/s]
    TORQUE,  # joint_torque [N·m], 0 if missing
    EXTERNAL,  # external_torque - load_stiffness·joint_pos [N·m]
    INERTIA,  # load_inertia [kg·m²]
    SECONDS,  # since the log began [s]
    KP,  # logged kp, 1 if missing
    KD,  # logged kd, 1 if missing
    SUPPLY,  # supply_voltage over the recipe's [-], 1 if missing
    TEMPERATURE_RISE,  # motor_temperature above the recipe's [K], 0 if missing
    STIFFNESS,  # load_stiffness [N·m/rad], 0 if missing
    READING,  # joint_reading [rad]
) = range(CHANNELS)
FRAME_CHANNELS = 4
(
    VELOCITY_TARGET,  # velocity_target [rad/s]
    FEEDFORWARD,  # torque_feedforward [N·m]
    KP_FACTOR,  # kp in force over KP [-]
    KD_FACTOR,  # kd in force over KD [-]
) = range(CHANNELS, CHANNELS + FRAME_CHANNELS)
VELOCITY_NOISE = 0.02  # maximum noise of differences of readings [rad/s]
MIN_WINDOW = 64  # minimum number of steps of a window that is shortened for the segments of a log
MIN_USED = 0.9  # share of the usable rows that windows of the chosen length must use
PAUSE = 60.0  # time between two segments after which motors count as cold again [s]
# rows per motor and least number of windows of `spread_windows`
SPREAD_ROWS = 2500
MIN_SPREAD_WINDOWS = 8
MEANS = (VEL, TORQUE, EXTERNAL)  # channels that a rollout averages with the row before
# optional channels of a log that an objective needs
_NEEDED = {
    "rollout": ("load_inertia", "external_torque"),
    "torque": ("joint_vel", "joint_torque"),
}


def training_data(log: MotorLog, recipe: Recipe, where: str) -> TrainingData:
    """Stack a motor log for training; a rollout needs no velocities or torques.

    Raises:
        LogError: wrong sample period, a missing channel, another firmware, or segments shorter than
            a window.
    """
    is_rollout = recipe.objective == "rollout"
    if is_rollout:
        log = with_velocities(without_noise(log) if log.encoder == "joint" else log)
    _require_usable(log, recipe, where)

    if log.has_command_frames and not recipe.grey_boxes:
        raise LogError(
            f"{log.command_mode} commands, or gains that change",
            where=where,
            remedy="use a preset of grey boxes, such as rollout or quick; networks learn position "
            "commands at constant gains only",
        )
    series = _stacked(log, recipe, where)
    segments = tuple(log.segment_slices())
    if is_rollout:
        # a velocity at t becomes the velocity at t - dt/2; a mean torque from t to t + dt becomes a
        # mean centred on t
        row_before = series.copy()
        for segment in segments:
            row_before[segment.start + 1 : segment.stop] = series[segment.start : segment.stop - 1]
        series[..., MEANS] = 0.5 * (series + row_before)[..., MEANS]

    return TrainingData(
        series=np.ascontiguousarray(series.transpose(1, 0, 2), dtype=np.float32),
        starts=window_starts(segments, recipe, where),
        segments=segments,
        scales=_scales(log, where),
        joint_names=log.joint_names,
        joint_classes=log.joint_classes,
        motor_models=log.motor_models,
        slow_commands=tuple(log.slow_commands),
        velocity_steps=_velocity_steps(log),
        has_torque=log.joint_torque is not None,
        command_mode=log.command_mode,
        logs_kd=log.logged_kd is not None,
        at_rotor=log.encoder == "rotor",
    )


def _stacked(log: MotorLog, recipe: Recipe, where: str) -> np.ndarray:
    """(R, M, CHANNELS) channels of the log, and FRAME_CHANNELS; a missing channel is 0."""

    def gains_of(segment: MotorLog) -> np.ndarray:
        return _gains(segment, recipe, where)

    def operating_conditions_of(segment: MotorLog) -> np.ndarray:
        return relative_operating_conditions(segment, recipe.nominal_conditions)

    seconds = np.broadcast_to(seconds_since_cold(log)[:, None], log.joint_pos.shape)
    channels = (
        log.position_target,
        log.joint_pos,
        log.joint_vel,
        log.joint_torque,
        log.external_torque,
        log.load_inertia,
        seconds,
        *_by_segment(log, gains_of),
        *_by_segment(log, operating_conditions_of),
        log.load_stiffness,
        log.readings,
    )
    if log.has_command_frames:
        factors = [gain_factors(segment) for segment in log.segments()]
        channels += (
            log.velocity_target,
            log.torque_feedforward,
            *np.concatenate(factors, axis=1),
        )
    missing = np.zeros_like(log.joint_pos)
    present = [missing if channel is None else channel for channel in channels]
    series = np.stack(present, axis=-1)

    # the external torque is that at angle 0; the simulation adds stiffness times its own angle
    series[..., EXTERNAL] -= series[..., STIFFNESS] * series[..., POS]
    return series


def _velocity_steps(log: MotorLog) -> int:
    """Steps over which noisy readings give velocities within VELOCITY_NOISE; 0 without noise."""
    noises = rms(log.readings - log.joint_pos, axis=0)  # (M,) [rad]
    if not noises.any():
        return 0
    noise = float(np.median(noises[noises > 0.0]))  # a static joint repeats its reading
    return max(1, math.ceil(math.sqrt(2.0) * noise / (VELOCITY_NOISE * log.period)))


def with_window_that_fits(recipe: Recipe, log: MotorLog) -> Recipe:
    """The recipe with the longest windows, up to its own, that use the segments of the log well.

    Windows lie end to end after the warm-up of a segment. A segment that is shorter than warm-up
    and window is not used at all, and neither is a remainder. Windows that use the log well are
    those that use MIN_USED of the rows that windows of another length could use. Only windows of
    rollouts are shortened, to no less than MIN_WINDOW steps.
    """
    if recipe.objective != "rollout":
        return recipe

    # steps of each segment after its warm-up; the last step of a window leads to one more row
    rows = [segment.stop - segment.start for segment in log.segment_slices()]
    steps = np.array(rows) - recipe.history - 1

    # lengths that fill a segment without remainder
    windows = {recipe.window}
    for length in np.unique(steps).tolist():
        for count in range(1, length // MIN_WINDOW + 1):
            windows.add(length // count)
    shortest = min(recipe.window, MIN_WINDOW)
    used_steps = {}
    for window in windows:
        if shortest <= window <= recipe.window:
            used_steps[window] = int(np.sum(np.maximum(steps, 0) // window * window))
    most_used = max(used_steps.values())
    if most_used == 0:  # `window_starts` refuses such a log
        return replace(recipe, window=shortest)

    fitting = [window for window, used in used_steps.items() if used >= MIN_USED * most_used]
    return replace(recipe, window=max(fitting))


def _by_segment(log: MotorLog, values: Callable[[MotorLog], np.ndarray]) -> np.ndarray:
    """(2, R, M) ``values`` (2, M) of each segment, repeated for all its rows."""
    rows = []
    for segment in log.segments():
        rows.append(np.repeat(values(segment)[:, None], segment.num_rows, axis=1))
    return np.concatenate(rows, axis=1)


def _gains(segment: MotorLog, recipe: Recipe, where: str) -> np.ndarray:
    """(2, M) logged kp and kd in the unit of the recipe; 1 if the recipe has no unit."""
    if not recipe.gain_unit or segment.command_mode == "torque":
        return np.ones((2, segment.num_joints))
    gains = segment.gains
    if gains is None or segment.gain_unit != recipe.gain_unit:
        problem = "no logged_kp" if gains is None else f"gains in {segment.gain_unit}"
        raise LogError(
            f"{problem}; the prior's motors have logged gains [{recipe.gain_unit}]",
            where=where,
            remedy="give kp and kd of every joint in the column map or as options of the import",
        )
    return gains


def relative_operating_conditions(segment: MotorLog, nominal: Mapping[str, float]) -> np.ndarray:
    """(2, M) operating conditions of a segment relative to the ``nominal`` ones, by channel.

    The first is the mean supply voltage over the nominal one [-], 1 if it is missing in log or
    ``nominal``. The second is the motor temperature above the nominal one [K], 0 if it is missing.
    """
    supply = np.ones(segment.num_joints)
    temperature_rise = np.zeros(segment.num_joints)
    logged = {
        name: means for name, means in segment.operating_conditions.items() if name in nominal
    }
    if "supply_voltage" in logged:
        supply = logged["supply_voltage"] / nominal["supply_voltage"]
    if "motor_temperature" in logged:
        temperature_rise = logged["motor_temperature"] - nominal["motor_temperature"]
    return np.stack([supply, temperature_rise])


def seconds_since_cold(log: MotorLog) -> np.ndarray:
    """(R,) time since the motors were cold [s].

    They are cold at the start, after a PAUSE, and where the clock restarts.
    """
    seconds = np.empty_like(log.time)
    start = log.time[0]
    previous_end = log.time[0]
    for segment in log.segment_slices():
        first = log.time[segment.start]
        if not previous_end <= first <= previous_end + PAUSE:
            start = first
        seconds[segment] = log.time[segment] - start
        previous_end = log.time[segment.stop - 1]
    return seconds


def _require_usable(log: MotorLog, recipe: Recipe, where: str) -> None:
    """Raise `LogError` for a missing channel, another sample period or another firmware."""
    for channel in _NEEDED[recipe.objective]:
        if getattr(log, channel) is None:
            remedy = "record the channel, or use preset rollout, which learns from positions"
            if recipe.objective == "rollout":
                remedy = (
                    "record the loads; or let mp.load_log or `motorprior logs import` compute them "
                    "(`suspended`, also for a fixed base); or fit them with mp.with_fitted_loads "
                    "or `motorprior logs import --fit-load`"
                )
            raise LogError(
                f"no {channel}, which the {recipe.objective} objective needs",
                where=where,
                remedy=remedy,
            )

    period = next(log.segments()).period
    if abs(period - recipe.period) > 0.01 * recipe.period:
        raise LogError(
            f"sample period {period:g} s, the preset's is {recipe.period:g} s",
            where=where,
            remedy=(
                "load a robot's log with mp.load_log or `motorprior logs import` and period "
                f"{recipe.period:g}; record a bench's with the bench preset of the same name"
            ),
        )

    firmware_difference = other_firmware(log.firmware, dict(recipe.firmware))
    if firmware_difference:
        raise LogError(
            f"{firmware_difference} (log and prior)",
            where=where,
            remedy="identify these logs by themselves",
        )


def window_starts(segments: Sequence[slice], recipe: Recipe, where: str) -> np.ndarray:
    """(S,) first rows of the windows that lie inside one of the ``segments``.

    Raises `LogError` if all segments are shorter than a window.
    """
    # the last step of a rollout leads to one more row
    length = recipe.history + recipe.window + (recipe.objective == "rollout")
    starts = [np.arange(segment.start, segment.stop - length + 1) for segment in segments]
    starts = np.concatenate(starts)
    if len(starts) == 0:
        max_rows = max(segment.stop - segment.start for segment in segments)
        seconds = length * recipe.period
        raise LogError(
            f"its longest segment has {max_rows} rows, a window {length} ({seconds:g} s)",
            where=where,
            remedy="use more of the log, or record longer segments",
        )
    return starts


def _scales(log: MotorLog, where: str) -> dict[str, float]:
    """Scales of `TrainingData`; raises `LogError` for a channel that is constant."""
    assert log.joint_vel is not None
    scales = {
        "error_scale": np.std(log.position_target - log.joint_pos),
        "velocity_scale": np.std(log.joint_vel),
        "torque_scale": 1.0,
        "torque_limit": 3.0,
    }
    if log.command_mode in ("velocity", "torque"):
        scales["error_scale"] = 1.0  # no angle is commanded, and no network is trained
    if log.joint_torque is not None:
        scales["torque_scale"] = np.std(log.joint_torque)
        scales["torque_limit"] = 1.2 * np.quantile(np.abs(log.joint_torque), 0.9995)

    for name, value in scales.items():
        if not value > 0:
            raise LogError(
                f"{name} is {value}: the channel is constant",
                where=where,
                remedy="record with an excitation that moves the motors",
            )
    return {name: float(value) for name, value in scales.items()}


def subsampled(data: TrainingData, recipe: Recipe, rows: int) -> TrainingData:
    """About ``rows`` rows of the data, in pieces of two to eight windows.

    The pieces are divided into equal sequences. The piece with the most motion is taken from each.
    Motion is the sum over the motors of the rms velocity in the piece over the rms velocity in all
    pieces. Data with no more rows are returned as they are.
    """
    total_rows = sum(segment.stop - segment.start for segment in data.segments)
    if total_rows <= rows:
        return data

    windows = max(2, min(8, (rows // 8 - recipe.history) // recipe.window))
    length = recipe.history + windows * recipe.window + 1
    pieces = []
    for segment in data.segments:
        for first in range(segment.start, segment.stop - length + 1, length):
            pieces.append(slice(first, first + length))
    # no segment is long enough: the segments are the pieces
    pieces = pieces or list(data.segments)

    piece_rows = pieces[0].stop - pieces[0].start
    count = max(2, min(len(pieces), rows // piece_rows))
    speeds = np.array([rms(data.series[:, piece, VEL], axis=1) for piece in pieces])
    motion = np.sum(speeds / np.maximum(rms(speeds, axis=0), 1e-9), axis=1)
    kept = []
    for sequence in np.array_split(np.arange(len(pieces)), count):
        kept.append(int(sequence[motion[sequence].argmax()]))
    return replace(data, segments=tuple(pieces[index] for index in kept))


def spread_windows(
    data: TrainingData, recipe: Recipe, is_faulty: np.ndarray | None = None
) -> TrainingData:
    """Single windows with their warm-ups, evenly spread over the segments: about SPREAD_ROWS.

    Windows with a faulty row (R,) are left out. There may be none.
    """
    length = recipe.history + recipe.window + 1
    pieces = []
    for segment in data.segments:
        for first in range(segment.start, segment.stop - length + 1, length):
            piece = slice(first, first + length)
            if is_faulty is None or not is_faulty[piece].any():
                pieces.append(piece)
    count = min(len(pieces), max(MIN_SPREAD_WINDOWS, SPREAD_ROWS // length))
    kept = np.unique(np.linspace(0, len(pieces) - 1, count).round().astype(int))
    return replace(data, segments=tuple(pieces[index] for index in kept))


def used_seconds_text(data: TrainingData, recipe: Recipe) -> str:
    """Text with the seconds of log that lie in windows.

    Warm-ups, and remainders that are shorter than a window, are not used.
    """
    # windows of grey boxes lie end to end
    step = recipe.window if recipe.grey_boxes else 1
    total_rows = 0
    used_rows = 0
    for segment in data.segments:
        rows = segment.stop - segment.start
        total_rows += rows
        free_rows = rows - recipe.history - (recipe.objective == "rollout")
        if free_rows >= recipe.window:
            used_rows += free_rows // step * step

    used = used_rows * recipe.period
    total = total_rows * recipe.period
    return f"fitted to {used:.1f} s of {total:.1f} s of log"
