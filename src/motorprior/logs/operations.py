"""Operations on logs: gaps, grid, noise, repeated rows, joining, halves.

`loads` computes the loads of a log.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from motorprior.exceptions import LogError, listed
from motorprior.logs.command_modes import in_common_mode
from motorprior.logs.motor_log import (
    INTEGER_CHANNELS,
    JOINT_SERIES,
    MIN_ROWS,
    MotorLog,
    channels,
    checked,
    other_firmware,
)
from motorprior.signals import mean_command

GAP_FACTOR = 5.0  # a gap is a time step longer than this many medians of its segment
# channels of commands, which are held until the next row; the grid has their means
COMMANDS = ("position_target", "velocity_target", "torque_feedforward")
_MAX_NAMED = 5  # gaps that the message lists
# channels that are held until the next row; the others are interpolated
_HELD = ("load_inertia", "logged_kp", "logged_kd", *INTEGER_CHANNELS)


def gap_rows(log: MotorLog) -> np.ndarray:
    """(G,) rows after a gap: a time step of more than 5 medians of the steps of the segment."""
    rows = [np.zeros(0, dtype=np.intp)]
    for segment in log.segment_slices():
        steps = np.diff(log.time[segment])
        if len(steps):
            is_gap = steps > GAP_FACTOR * np.median(steps)
            rows.append(1 + segment.start + np.flatnonzero(is_gap))
    return np.concatenate(rows)


def split_at_gaps(log: MotorLog, period: float = 0.0) -> tuple[MotorLog, str]:
    """Begin a segment after every gap, so that nothing is interpolated or fitted across a gap.

    A run of rows next to a gap is dropped if it has fewer than 4 rows, or if it is shorter than
    ``period`` [s], the period of the log's later grid.

    Returns:
        The log with renumbered segments, and a text about the gaps; the same log and "" if there
        are no gaps.

    Raises:
        LogError: no run of rows remains.
    """
    gaps = gap_rows(log)
    if not gaps.size:
        return log, ""

    runs = _runs_between(gaps, log, period)
    if not runs:
        raise LogError(
            f"no run of {MIN_ROWS} rows without a gap of more than {GAP_FACTOR:g} median steps",
            where=log.source,
            remedy="record the time at which a row was measured, not received; or state rate in a "
            "column map",
        )
    segment = np.repeat(np.arange(len(runs)), [len(run) for run in runs])
    kept = replace(log.rows(np.concatenate(runs)), segment=segment)
    return checked(kept), _gap_text(log, gaps, log.num_rows - kept.num_rows)


def _runs_between(gaps: np.ndarray, log: MotorLog, period: float) -> list[np.ndarray]:
    """Rows of each run between gaps and ends of segments, without short runs next to gaps."""
    begins_after_gap = set(gaps.tolist())
    segment_starts = {segment.start for segment in log.segment_slices()}
    bounds = sorted(segment_starts | begins_after_gap | {log.num_rows})

    runs = []
    for first, last in pairwise(bounds):
        is_next_to_gap = first in begins_after_gap or last in begins_after_gap
        is_short = last - first < MIN_ROWS or log.time[last - 1] - log.time[first] < period
        if not (is_short and is_next_to_gap):
            runs.append(np.arange(first, last))
    return runs


def _gap_text(log: MotorLog, gaps: np.ndarray, num_dropped: int) -> str:
    steps = log.time[gaps] - log.time[gaps - 1]
    places = [
        f"{step:.3g} s before row {row}, at {log.time[row]:.6g} s"
        for step, row in zip(steps, gaps, strict=True)
    ]
    text = f"gaps longer than {GAP_FACTOR:g} median steps: {len(gaps)}; "
    text += f"{listed(places, _MAX_NAMED)}; a segment begins after each"
    if num_dropped:
        text += f"; {num_dropped} rows between gaps, too few to use, are left out"
    return text


def resample(log: MotorLog, period: float) -> MotorLog:
    """Put each segment on the grid t_k = t_0 + k·period, up to its last row.

    The command of a row is the mean of the recorded, held commands over the period that begins at
    the row. If it were only the command at the row's time, a command that was recorded between two
    rows would act up to a period late, and identified delays would be too short. Measurements are
    interpolated linearly. Drop repeated measurements first (`drop_repeats`), or the result moves in
    steps.

    Raises:
        LogError: the period is longer than a segment.
    """
    segments = [_resampled(segment, period) for segment in log.segments()]
    values = {}
    for name in segments[0]:
        values[name] = np.concatenate([segment[name] for segment in segments])
    return checked(replace(log, **values))


def _resampled(segment: MotorLog, period: float) -> dict[str, np.ndarray]:
    """Channels of one segment on the grid."""
    start = float(segment.time[0])
    duration = float(segment.time[-1]) - start
    num_periods = duration / period * (1.0 + 1e-12)
    num_rows = math.floor(num_periods + 1e-6) + 1  # a last period may be short by rounding
    grid = start + period * np.arange(num_rows)
    if len(grid) < 2:
        raise LogError(
            f"period {period} s is longer than the segment at {start:g} s, which lasts "
            f"{duration:g} s",
            where=segment.source,
            remedy="choose a shorter period",
        )

    # the last recorded row at each time of the grid, with a tolerance for rounding
    rows_after = np.searchsorted(segment.time, grid + 1e-6 * period, side="right")
    row_in_force = rows_after - 1
    values = {"time": grid}
    for name, channel in channels(segment).items():
        if name in COMMANDS:
            values[name] = mean_command(segment.time, channel, grid, period)
        elif name in _HELD:
            values[name] = channel[row_in_force]
        elif name not in values:
            columns = [np.interp(grid, segment.time, column) for column in channel.T]
            values[name] = np.stack(columns, axis=1)
    return values


def without_noise(log: MotorLog) -> MotorLog:
    """The log with smoothed angles and velocities (`smoothing`).

    The log itself if it has been smoothed already, or is free of noise.
    """
    from motorprior.logs.smoothing import smoothed, smoothing_of  # it compiles

    if log.joint_reading is not None:
        return log
    segments = tuple(log.segment_slices())
    noise_and_jerk = smoothing_of(log.joint_pos, segments, log.period)
    if noise_and_jerk is None:
        return log
    noise, jerk_density = noise_and_jerk
    pos, vel = smoothed(log.joint_pos, segments, log.period, noise, jerk_density)
    return replace(log, joint_pos=pos, joint_vel=vel, joint_reading=log.joint_pos)


def with_velocities(log: MotorLog) -> MotorLog:
    """The log with velocities: the recorded ones, or else differences of its angles."""
    if log.joint_vel is not None:
        return log
    velocity = np.zeros_like(log.joint_pos)
    for segment in log.segment_slices():
        if segment.stop - segment.start > 2:
            velocity[segment] = np.gradient(
                log.joint_pos[segment], log.time[segment], axis=0, edge_order=2
            )
    return replace(log, joint_vel=velocity)


def smooth_on_grid(log: MotorLog, period: float) -> MotorLog:
    """The log at steps of ``period`` [s], with angles by splines through smoothed readings.

    The channel joint_reading has splines through the raw readings. Velocities are the derivatives
    of the smoothed angles' splines: recorded velocities are often filtered, and loads need
    accelerations. Commands of a motion in progress are smoothed like the angles: held commands
    would move the simulated motor in steps between the rows, which splines through its angles do
    not show. Commands keep their events (`command_events`). Gains are never smoothed.
    """
    from scipy.interpolate import CubicSpline  # takes half a second

    from motorprior.logs.smoothing import smoothed, smoothing_of

    segments = tuple(log.segment_slices())
    grid = resample(log, period)
    angles = log.joint_pos
    noise_and_jerk = smoothing_of(angles, segments, log.period)
    if noise_and_jerk is not None:
        noise, jerk_density = noise_and_jerk
        angles, _ = smoothed(angles, segments, log.period, noise, jerk_density)
        noise_on_grid = noise * math.sqrt(log.period / period)  # the same smoothing, see `smoothed`
        grid = _with_smooth_commands(grid, log, noise_on_grid, jerk_density)

    pos = np.empty_like(grid.joint_pos)
    vel = np.empty_like(grid.joint_pos)
    reading = np.empty_like(grid.joint_pos)
    for recorded, resampled in zip(segments, grid.segment_slices(), strict=True):
        smooth = CubicSpline(log.time[recorded], angles[recorded])
        raw = CubicSpline(log.time[recorded], log.joint_pos[recorded])
        pos[resampled] = smooth(grid.time[resampled])
        vel[resampled] = smooth(grid.time[resampled], 1)
        reading[resampled] = raw(grid.time[resampled])
    return replace(grid, joint_pos=pos, joint_vel=vel, joint_reading=reading)


# Rows of a motion in progress have changes of the command that differ by less than this share of
# themselves from those of the neighbouring rows, in at least this number of successive rows.
_SIMILAR = 0.5
_MOTION_ROWS = 5
# A target in encoder quanta that moves by less than a quantum per row changes by fewer than this.
_ROUNDED_QUANTA = 2.1
_DIGITS = 1e-6  # smaller differences are rounding of the numbers in a file [rad]


def command_events(log: MotorLog, name: str) -> np.ndarray:
    """(T, J) whether the sender changed a channel of COMMANDS at once, at this row.

    Every change is an event unless it belongs to a motion in progress, or rounding explains it:
    the position target is in quanta of the joint's encoder, or in smaller ones, and changes by at
    most two.
    """
    from scipy.ndimage import binary_opening  # takes half a second

    command = channels(log)[name]
    rounding = np.zeros(log.num_joints)
    if name == "position_target":
        quanta = _quanta(command)
        rounding = np.where(quanta < 1.5 * _quanta(log.joint_pos), _ROUNDED_QUANTA * quanta, 0.0)

    is_event = np.zeros(command.shape, bool)
    for segment in log.segment_slices():
        change = np.diff(command[segment], axis=0)
        static = np.zeros_like(change[:1])
        change_before = np.concatenate([static, change[:-1]])
        change_after = np.concatenate([change[1:], static])
        size = np.abs(change)
        is_similar = np.abs(change - change_before) < _SIMILAR * size
        is_similar &= np.abs(change - change_after) < _SIMILAR * size
        is_motion: np.ndarray = np.asarray(binary_opening(is_similar, np.ones((_MOTION_ROWS, 1))))
        is_event[segment][1:] = (size > rounding) & ~is_motion
    return is_event


def _quanta(angles: np.ndarray) -> np.ndarray:
    """(J,) smallest differences between values of the columns (T, J) [rad]; 0 if one is static."""
    quanta = np.zeros(angles.shape[1])
    for joint, column in enumerate(angles.T):
        differences: np.ndarray = np.diff(np.unique(column))
        differences = differences[differences > _DIGITS]
        if len(differences):
            quanta[joint] = differences.min()
    return quanta


def _with_smooth_commands(
    grid: MotorLog, log: MotorLog, noise: float, jerk_density: float
) -> MotorLog:
    """The log on its grid with commands that are smoothed between their events.

    ``log`` is the recording. The noise [rad] and the jerk density are those of the angles on the
    grid.
    """
    from motorprior.logs.smoothing import smoothed

    values = {name: channels(grid)[name].copy() for name in COMMANDS if name in channels(grid)}
    if log.command_mode in ("velocity", "torque"):
        del values["position_target"]  # it is the angle
    for name, commands in values.items():
        is_event = command_events(log, name)
        for joint in range(grid.num_joints):
            event_times = log.time[is_event[:, joint]]
            pieces = []
            for segment in grid.segment_slices():
                pieces += _pieces_between(event_times, grid.time, segment, grid.period)
            column = commands[:, joint, None]
            smooth, _ = smoothed(column, tuple(pieces), grid.period, noise, jerk_density)
            for piece in pieces:
                commands[piece, joint] = smooth[piece, 0]
    return replace(grid, **values)


def _pieces_between(
    event_times: np.ndarray, time: np.ndarray, segment: slice, period: float
) -> list[slice]:
    """Runs of rows of a segment that no event divides.

    A row in whose period an event falls has a mean of the commands before and after the event: it
    is in no run.
    """
    first_after = np.searchsorted(time[segment], event_times - 1e-6 * period) + segment.start
    last_before = np.searchsorted(time[segment] + period, event_times + 1e-6 * period, "right")
    last_before += segment.start
    starts = [segment.start, *first_after.tolist()]
    stops = [*last_before.tolist(), segment.stop]
    pieces = []
    for start, stop in zip(starts, stops, strict=True):
        first = max(start, segment.start)
        last = min(stop, segment.stop)
        if last - first > 1:
            pieces.append(slice(first, last))
    return pieces


def repeated_rows(log: MotorLog) -> np.ndarray:
    """Mask (T,) of rows whose angles all equal those of the previous row of the same segment."""
    repeated = np.all(np.diff(log.joint_pos, axis=0, prepend=np.nan) == 0.0, axis=1)
    repeated[[segment.start for segment in log.segment_slices()]] = False
    return repeated


def drop_repeats(log: MotorLog) -> MotorLog:
    """Keep the first row of every run of equal angles.

    A robot that answers more slowly than its host polls repeats its angles.
    """
    return checked(log.rows(~repeated_rows(log)))


def joined(logs: Sequence[MotorLog]) -> MotorLog:
    """Join logs into one.

    Logs with equal joint names become consecutive segments. Logs without common joint names are
    recordings of different motors: their joints become columns of one log, cut to the shortest and
    with the times of the first. Logs of different command modes get a common one
    (`command_modes.in_common_mode`).

    Raises:
        LogError: no log; some joint names in common; different robots, channels, encoders, gain
            units or firmware; gains in some of them; or, for different motors, segments that begin
            at different rows.
    """
    if not logs:
        raise LogError("no log given", remedy="give at least one")
    if len(logs) == 1:
        return logs[0]
    logs = in_common_mode(logs)
    first = logs[0]
    for log in logs[1:]:
        _require_equal_settings(first, log)

    source = "; ".join(dict.fromkeys(log.source for log in logs))
    names = [name for log in logs for name in log.joint_names]
    if all(log.joint_names == first.joint_names for log in logs):
        whole = _in_sequence(logs)
    elif len(set(names)) == len(names):
        whole = _side_by_side(logs, source)
    else:
        raise LogError(
            "some of the logs' joint names are equal",
            where=source,
            remedy="give each motor its own joint name, or give logs of the same joints in the "
            "same order",
        )
    return checked(replace(whole, source=source))


def _require_equal_settings(first: MotorLog, log: MotorLog) -> None:
    problems = [
        f"{name} {getattr(log, name)!r}, another log has {getattr(first, name)!r}"
        for name in ("robot", "motor", "encoder", "gain_unit")
        if getattr(first, name) != getattr(log, name)
    ]
    # registers and channels that only one of the two logs has
    registers = set(first.firmware).symmetric_difference(log.firmware)
    channel_names = set(channels(first)).symmetric_difference(channels(log))
    channel_names.discard("segment")
    missing = [*sorted(f"firmware.{name}" for name in registers), *sorted(channel_names)]
    if missing:
        problems.append(f"only some of the logs have {', '.join(missing)}")
    register_problem = other_firmware(log.firmware, first.firmware)
    if register_problem:
        problems.append(register_problem)

    if problems:
        raise LogError(
            problems[0],
            where=log.source,
            remedy="import all with the same channels, gains and registers, or fit one at a time",
        )


def _in_sequence(logs: Sequence[MotorLog]) -> MotorLog:
    """Logs of the same joints as consecutive segments."""
    segments: list[MotorLog] = []
    for log in logs:
        segments += log.segments()
    index = np.repeat(np.arange(len(segments)), [segment.num_rows for segment in segments])

    values = {}
    for name in channels(logs[0]).keys() - {"segment"}:
        values[name] = np.concatenate([channels(segment)[name] for segment in segments])
    return replace(logs[0], **values, segment=index, slow_commands=_slow_commands(logs))


def _slow_commands(logs: Sequence[MotorLog]) -> dict[str, float]:
    """`MotorLog.slow_commands` of all logs."""
    slow: dict[str, float] = {}
    for log in logs:
        slow |= log.slow_commands
    return slow


def _side_by_side(logs: Sequence[MotorLog], source: str) -> MotorLog:
    """Logs of different motors as columns, cut to the shortest."""
    num_rows = min(log.num_rows for log in logs)
    cut_logs = [log.rows(slice(0, num_rows)) for log in logs]
    first = cut_logs[0]
    if any(log.segment_slices() != first.segment_slices() for log in cut_logs):
        problem = "the logs' segments begin at different rows"
        raise LogError(problem, where=source, remedy="record all motors with the same segments")

    values = {}
    for name in channels(first).keys() & JOINT_SERIES.keys():
        values[name] = np.concatenate([channels(log)[name] for log in cut_logs], axis=1)
    names = tuple(name for log in logs for name in log.joint_names)
    classes = tuple(name for log in logs for name in log.given_classes)
    models = tuple(model for log in logs for model in log.motor_models)
    return replace(
        first,
        joint_names=names,
        given_classes=classes if len(classes) == len(names) else (),
        motor_models=models if len(models) == len(names) else (),
        bodies="",
        slow_commands=_slow_commands(logs),
        **values,
    )


EXCITED_STD = 1e-3  # standard deviation above which a command or an angle moves [rad]
# standard deviation above which a joint whose command does not move counts as moved, not only as
# swaying within its backlash [rad]
MOVED_STD = 1e-2


def train_test_halves(log: MotorLog) -> tuple[MotorLog, MotorLog]:
    """Cut a log in two at the segment start nearest to its middle row.

    A log of one segment is cut at its middle row.
    """
    starts = [segment.start for segment in log.segment_slices()[1:]]
    middle = log.num_rows / 2
    cut = min(starts, key=lambda row: abs(row - middle), default=log.num_rows // 2)
    return log.rows(slice(0, cut)), log.rows(slice(cut, None))


def excited_joints(log: MotorLog) -> np.ndarray:
    """Indices of the joints whose command has a standard deviation above 1 mrad."""
    return np.flatnonzero(np.std(log.position_target, axis=0) > EXCITED_STD)


def moved(log: MotorLog) -> np.ndarray:
    """(J,) whether a joint moves: with its command, or by more than MOVED_STD without a command."""
    pos_std = np.std(log.joint_pos, axis=0)
    target_std = np.std(log.position_target, axis=0)
    return (pos_std > EXCITED_STD) & ((target_std > EXCITED_STD) | (pos_std > MOVED_STD))


def static_joints(log: MotorLog) -> tuple[str, ...]:
    """Names of the joints whose angle has a standard deviation of at most 1 mrad."""
    is_static = np.std(log.joint_pos, axis=0) <= EXCITED_STD
    return tuple(np.array(log.joint_names)[is_static].tolist())
