"""Training data: logs as stacked arrays, and windows that never cross the end of a segment."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.exceptions import LogError, listed
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
# Segments whose values differ by half of these from the median segment count as alike.
LOAD_STEP = 0.7  # of the logarithm of the load inertia
CONDITION_STEPS = (0.05, 10.0)  # of the supply voltage over the nominal one, and temperature [K]
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
    segments = tuple(log.segment_slices())
    return TrainingData(
        series=_stacked(log, recipe, where),
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
    """(M, R, CHANNELS) channels of the log, and FRAME_CHANNELS; a missing channel is 0."""

    def gains_of(segment: MotorLog) -> np.ndarray:
        return _gains(segment, recipe, where)

    def operating_conditions_of(segment: MotorLog) -> np.ndarray:
        return relative_operating_conditions(segment, recipe.nominal_conditions)

    # the external torque is that at angle 0; the simulation adds stiffness times its own angle
    external = log.external_torque
    if log.external_torque is not None and log.load_stiffness is not None:
        external = log.external_torque - log.load_stiffness * log.joint_pos
    channels = (
        log.position_target,
        log.joint_pos,
        log.joint_vel,
        log.joint_torque,
        external,
        log.load_inertia,
        np.broadcast_to(seconds_since_cold(log)[:, None], log.joint_pos.shape),
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

    # one channel at a time: an hour of twelve joints has gigabytes
    series = np.zeros((log.num_joints, log.num_rows, len(channels)), dtype=np.float32)
    for index, values in enumerate(channels):
        if values is None:
            continue
        if recipe.objective == "rollout" and index in MEANS:
            values = _means_with_row_before(values, log.segment_slices())
        series[..., index] = values.T
    return series


def _means_with_row_before(values: np.ndarray, segments: Sequence[slice]) -> np.ndarray:
    """(R, M) means of the values of each row and of the row before it in its segment.

    A velocity at t becomes the velocity at t - dt/2; a mean torque from t to t + dt becomes a mean
    centred on t.
    """
    means = values.copy()
    for segment in segments:
        first = segment.start
        later = slice(first + 1, segment.stop)
        means[later] = 0.5 * (values[later] + values[first : segment.stop - 1])
    return means


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
    """(2, R, M) float32 ``values`` (2, M) of each segment, repeated for all its rows."""
    rows = []
    for segment in log.segments():
        of_segment = values(segment).astype(np.float32)
        rows.append(np.repeat(of_segment[:, None], segment.num_rows, axis=1))
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

    Segments are cut into pieces; a segment that is shorter than a piece is one piece. At several
    gains, the pieces are short enough to take two of each segment. Each gain gives equally many
    rows, or all that it has, and so do the groups of each gain (`_groups`). The pieces of a group
    are divided, in time, into sequences with equal numbers of pieces. The piece with the most
    motion is taken from each. Motion is the sum over the motors of the rms velocity in the piece
    over the rms velocity in all pieces.

    Data with no more rows are returned as they are.
    """
    total_rows = sum(segment.stop - segment.start for segment in data.segments)
    if total_rows <= rows:
        return data

    starts = [segment.start for segment in data.segments]
    gain = _distinct(data.series[:, starts][..., [KP, KD]].transpose(1, 0, 2))
    min_pieces = max(8, 2 * len(starts)) if gain.any() else 8
    windows = max(2, min(8, (rows // min_pieces - recipe.history) // recipe.window))
    length = recipe.history + windows * recipe.window + 1
    shortest = recipe.history + recipe.window + 1
    pieces = []
    of_segment = []
    for index, segment in enumerate(data.segments):
        segment_rows = segment.stop - segment.start
        if segment_rows < shortest:
            continue
        piece_rows = min(length, segment_rows)
        if gain.any():  # no remainder, which a rare gain may need
            piece_rows = segment_rows // (segment_rows // piece_rows)
        for first in range(segment.start, segment.stop - piece_rows + 1, piece_rows):
            pieces.append(slice(first, first + piece_rows))
            of_segment.append(index)

    speeds = np.array([rms(data.series[:, piece, VEL], axis=1) for piece in pieces])
    motion = np.sum(speeds / np.maximum(rms(speeds, axis=0), 1e-9), axis=1)

    num_rows = np.array([piece.stop - piece.start for piece in pieces])
    rows = max(rows, 2 * int(num_rows.max()))
    max_groups = int(rows // num_rows.mean())
    groups = _groups(data, gain, np.array(of_segment), max_groups)
    indices = []
    unused_rows = 0  # rows of the quotas so far that are less than a piece
    for group, quota in _quotas(groups, num_rows, rows):
        group_rows = int(num_rows[group].sum())
        count = min(len(group), max(1, len(group) * (quota + unused_rows) // group_rows))
        unused_rows += quota - count * group_rows // len(group)
        for sequence in np.array_split(group, count):
            indices.append(int(sequence[motion[sequence].argmax()]))
    return replace(data, segments=tuple(pieces[index] for index in sorted(indices)))


def _groups(
    data: TrainingData, gain: np.ndarray, of_segment: np.ndarray, max_groups: int
) -> list[list[np.ndarray]]:
    """Indices of the pieces of segments ``of_segment`` (P,), by gain and group.

    The groups of a gain have one load and one range of operating conditions each. Loads are ignored
    if there are more than half as many as segments, as on a bench with another load in every
    segment, or if the groups were more than ``max_groups``; operating conditions likewise. More
    than ``max_groups`` gains count as one, whose pieces are in order of their gains. ``gain`` (S,)
    is the index of the gains of each segment.
    """
    order = np.argsort(gain[of_segment], kind="stable")
    segment = of_segment[order]
    if len(np.unique(gain[segment])) > max_groups:
        gain = np.zeros_like(gain)

    group = gain
    for key in (_distinct(_constant_loads(data)), _distinct(_condition_ranges(data))):
        finer = _distinct(np.column_stack([group, key]))
        is_repeated = len(np.unique(key[segment])) <= len(key) // 2
        if is_repeated and len(np.unique(finer[segment])) <= max_groups:
            group = finer

    groups = []
    for one_gain in np.unique(gain[segment]):
        of_gain = np.unique(group[segment][gain[segment] == one_gain])
        groups.append([order[group[segment] == index] for index in of_gain])
    return groups


def _quotas(
    groups: Sequence[Sequence[np.ndarray]], num_rows: np.ndarray, rows: int
) -> list[tuple[np.ndarray, int]]:
    """The groups of all gains, and how many of ``rows`` rows each of them gives.

    ``num_rows`` are those of the pieces, whose indices ``groups`` holds by gain.
    """
    by_gain = [[int(num_rows[group].sum()) for group in of_gain] for of_gain in groups]
    quotas = []
    gain_quotas = _equal_quotas([sum(available) for available in by_gain], rows)
    for of_gain, available, gain_quota in zip(groups, by_gain, gain_quotas, strict=True):
        quotas += zip(of_gain, _equal_quotas(available, gain_quota), strict=True)
    return quotas


def _distinct(values: np.ndarray) -> np.ndarray:
    """(S,) index of the values (S, …) of each segment among the distinct ones."""
    rows = values.reshape(len(values), -1)
    return np.unique(rows, axis=0, return_inverse=True)[1].ravel()


def _constant_loads(data: TrainingData) -> np.ndarray:
    """(S, M) load inertia of each segment relative to the median segment, in steps of LOAD_STEP.

    It is 0 for a motor whose inertia depends on the pose, so that it varies within a segment.
    """
    loads = np.zeros((len(data.segments), len(data.series)))
    is_constant = np.ones(len(data.series), dtype=bool)
    for index, segment in enumerate(data.segments):
        inertia = data.series[:, segment, INERTIA]
        mean = np.maximum(inertia.mean(axis=1), 1e-9)
        loads[index] = np.log(mean)
        is_constant &= np.ptp(inertia, axis=1) <= 0.01 * mean
    steps = np.round((loads - np.median(loads, axis=0)) / LOAD_STEP)
    return np.where(is_constant, steps, 0.0)


def _condition_ranges(data: TrainingData) -> np.ndarray:
    """(S, 2) supply voltage and temperature of each segment, means over the motors.

    They are relative to the median segment, in steps of CONDITION_STEPS.
    """
    starts = [segment.start for segment in data.segments]
    conditions = data.series[:, starts][..., [SUPPLY, TEMPERATURE_RISE]].mean(axis=0)
    return np.round((conditions - np.median(conditions, axis=0)) / CONDITION_STEPS)


def _equal_quotas(available: Sequence[int], total: int) -> list[int]:
    """Equal quotas that add up to at most ``total``.

    What a group with less available leaves, the others share.
    """
    quotas = [0] * len(available)
    remaining = total
    by_size = sorted(range(len(available)), key=lambda group: available[group])
    for place, group in enumerate(by_size):
        quotas[group] = min(available[group], remaining // (len(available) - place))
        remaining -= quotas[group]
    return quotas


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


def used_seconds_text(data: TrainingData, recipe: Recipe, log: MotorLog) -> str:
    """Text with the seconds of ``log`` that lie in windows of ``data``, and the segments without.

    Warm-ups, and remainders that are shorter than a window, are not used. A segment has the name of
    its file if each file is one segment, and otherwise its number.
    """
    # windows of grey boxes lie end to end
    step = recipe.window if recipe.grey_boxes else 1
    used_rows = 0
    is_used = np.zeros(log.num_rows, dtype=bool)
    for segment in data.segments:
        rows = segment.stop - segment.start
        free_rows = rows - recipe.history - (recipe.objective == "rollout")
        if free_rows >= recipe.window:
            used_rows += free_rows // step * step
            is_used[segment] = True

    segments = log.segment_slices()
    names = log.source.split("; ")
    if len(names) != len(segments):
        names = [f"segment {number}" for number in range(1, len(segments) + 1)]
    shortest = recipe.history + recipe.window + (recipe.objective == "rollout")
    too_short = []
    not_chosen = []
    for name, segment in zip(names, segments, strict=True):
        if segment.stop - segment.start < shortest:
            too_short.append(name)
        elif not is_used[segment].any():
            not_chosen.append(name)

    used = used_rows * recipe.period
    total = log.num_rows * recipe.period
    text = f"fitted to {used:.1f} s of {total:.1f} s of log"
    if too_short:
        shortest_seconds = shortest * recipe.period
        text += f"; shorter than {shortest_seconds:.2f} s, not used: {listed(too_short, 3)}"
    if not_chosen:
        text += f"; not chosen: {listed(not_chosen, 3)}"
    return text
