"""Operations on logs: gaps, grid, noise, repeats, joining. Loads: `loads`."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from motorprior.exceptions import LogError, listed
from motorprior.logs.motor_log import (
    CODES,
    JOINT_SERIES,
    MIN_ROWS,
    MotorLog,
    channels,
    checked,
    other_firmware,
)
from motorprior.signals import mean_command

GAP_FACTOR = 5.0  # a gap is a time step longer than this many medians of its segment
MAX_SMOOTHING = 0.5  # maximum change of commands by smoothing [rad]
_MAX_NAMED = 5  # gaps that the message lists
# Channels that are held until the next row; the others are interpolated
_HELD = ("load_inertia", "logged_kp", "logged_kd", *CODES)


def gap_rows(log: MotorLog) -> np.ndarray:
    """(G,) rows before which more than 5 median time steps of their segment passed."""
    parts = [(part.start, np.diff(log.time[part])) for part in log.segment_slices()]
    found = [
        1 + start + np.flatnonzero(steps > GAP_FACTOR * np.median(steps))
        for start, steps in parts
        if len(steps)
    ]
    return np.concatenate([np.zeros(0, dtype=np.intp), *found])


def begin_at_gaps(log: MotorLog, period: float = 0.0) -> tuple[MotorLog, str]:
    """Begin a segment after every gap, so that nothing is interpolated or fitted across it.

    Pieces next to gaps are dropped if they have fewer than 4 rows, or are shorter than the
    ``period`` [s] of the grid for the log; LogError if none remains. Returns the log, its segments
    renumbered, and a sentence about the gaps; the same log and "" if there are none.
    """
    gaps = gap_rows(log)
    if not gaps.size:
        return log, ""
    after = set(gaps.tolist())
    kept_runs = []
    for first, last in pairwise(
        sorted({part.start for part in log.segment_slices()} | after | {log.num_rows})
    ):
        short = last - first < MIN_ROWS or log.time[last - 1] - log.time[first] < period
        if not (short and after & {first, last}):
            kept_runs.append(np.arange(first, last))
    if not kept_runs:
        problem = (
            f"no run of {MIN_ROWS} rows without a gap of more than {GAP_FACTOR:g} median steps"
        )
        remedy = "record the time at which a row was measured, not received; or state rate in a column map"
        raise LogError(problem, where=log.source, remedy=remedy)
    segment = np.repeat(np.arange(len(kept_runs)), [len(run) for run in kept_runs])
    kept = replace(log.rows(np.concatenate(kept_runs)), segment=segment)
    steps = log.time[gaps] - log.time[gaps - 1]
    dropped = log.num_rows - kept.num_rows
    named = [
        f"{step:.3g} s before row {row}, at {log.time[row]:.6g} s"
        for step, row in zip(steps, gaps, strict=True)
    ]
    text = f"gaps longer than {GAP_FACTOR:g} median steps: {len(gaps)}; {listed(named, _MAX_NAMED)}; a segment begins "
    text += "after each" + (
        f"; {dropped} rows between gaps, too few to use, are left out" if dropped else ""
    )
    return checked(kept), text


def resample(log: MotorLog, period: float) -> MotorLog:
    """Put each segment on the grid t_k = t_0 + k·period, up to its last row.

    Each row has the mean of the held commands from its time to the next row. With the command at
    its time, commands between two rows would act up to a period late, and identified delays would
    be too short. Measurements are interpolated linearly. Drop repeated measurements first
    (`drop_repeats`), or the result moves in steps.

    Raises LogError for a period that is longer than a segment.
    """
    parts = [_resample_segment(segment, period) for segment in log.segments()]
    return checked(
        replace(log, **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})
    )


def _resample_segment(segment: MotorLog, period: float) -> dict[str, np.ndarray]:
    start = float(segment.time[0])
    end = float(segment.time[-1])
    grid = start + period * np.arange(math.floor((end - start) / period * (1.0 + 1e-12) + 1e-6) + 1)
    if len(grid) < 2:
        problem = f"period {period} s is longer than the segment at {start:g} s, which lasts {end - start:g} s"
        raise LogError(problem, where=segment.source, remedy="choose a shorter period")
    held = np.searchsorted(segment.time, grid + 1e-6 * period, side="right") - 1
    result = {
        "position_target": mean_command(segment.time, segment.position_target, grid, period),
        "time": grid,
    }
    for name, value in channels(segment).items():
        if name in _HELD:
            result[name] = value[held]
        elif name not in result:
            result[name] = np.stack(
                [np.interp(grid, segment.time, column) for column in value.T], axis=1
            )
    return result


def without_noise(log: MotorLog) -> MotorLog:
    """The log with smoothed angles and velocities (`smoothing`); unchanged if it is smoothed or free of noise."""
    from motorprior.logs.smoothing import smoothed, smoothing_of  # it compiles

    parts = tuple(log.segment_slices())
    found = (
        None if log.joint_reading is not None else smoothing_of(log.joint_pos, parts, log.period)
    )
    if found is None:
        return log
    pos, vel = smoothed(log.joint_pos, parts, log.period, *found)
    return replace(log, joint_pos=pos, joint_vel=vel, joint_reading=log.joint_pos)


def with_velocities(log: MotorLog) -> MotorLog:
    """The log with velocities: its own, or differences of its angles."""
    if log.joint_vel is not None:
        return log
    found = np.zeros_like(log.joint_pos)
    for part in log.segment_slices():
        if part.stop - part.start > 2:
            found[part] = np.gradient(log.joint_pos[part], log.time[part], axis=0, edge_order=2)
    return replace(log, joint_vel=found)


def smooth_on_grid(log: MotorLog, period: float) -> MotorLog:
    """The log at steps of ``period`` [s]; angles are splines through smoothed readings, joint_reading through raw ones.

    Velocities are the splines' derivatives: recorded ones are often filtered, and loads need
    accelerations. Commands are smoothed like the angles, since many logs give both late by up to a
    sample, unless that changes them by MAX_SMOOTHING or more: large steps drive a motor to its
    limit.
    """
    from scipy.interpolate import CubicSpline  # takes half a second

    from motorprior.logs.smoothing import smoothed, smoothing_of

    parts = tuple(log.segment_slices())
    grid = resample(log, period)
    angles = log.joint_pos
    found = smoothing_of(angles, parts, log.period)
    if found is not None:
        angles = smoothed(angles, parts, log.period, *found)[0]
        noise = found[0] * math.sqrt(log.period / period)
        rows = tuple(grid.segment_slices())
        commands = smoothed(grid.position_target, rows, period, noise, found[1])[0]
        moved = np.abs(commands - grid.position_target).max(axis=0)
        grid = replace(
            grid, position_target=np.where(moved < MAX_SMOOTHING, commands, grid.position_target)
        )
    pos, vel, reading = (np.empty_like(grid.joint_pos) for _ in range(3))
    for old, new in zip(parts, grid.segment_slices(), strict=True):
        smooth, raw = (CubicSpline(log.time[old], each[old]) for each in (angles, log.joint_pos))
        pos[new] = smooth(grid.time[new])
        vel[new] = smooth(grid.time[new], 1)
        reading[new] = raw(grid.time[new])
    return replace(grid, joint_pos=pos, joint_vel=vel, joint_reading=reading)


def repeated_rows(log: MotorLog) -> np.ndarray:
    """Mask (T,) of rows whose measured angles all equal those of the previous row of the same segment."""
    repeated = np.all(np.diff(log.joint_pos, axis=0, prepend=np.nan) == 0.0, axis=1)
    repeated[[part.start for part in log.segment_slices()]] = False
    return repeated


def drop_repeats(log: MotorLog) -> MotorLog:
    """Keep the first row of every run of equal angles of a robot that answers more slowly than its host polls."""
    return checked(log.rows(~repeated_rows(log)))


def joined(logs: Sequence[MotorLog]) -> MotorLog:
    """Join logs into one.

    Logs with equal joint names become consecutive segments. Logs without common joint names are
    recordings of different motors: their joints become columns of one log, cut to the shortest and
    with the times of the first.

    Raises:
        LogError: no log; some joint names in common; different robots, channels, encoders, gain
            units or firmware; or, for different motors, segments that begin at different rows.
    """
    if not logs:
        raise LogError("no log given", remedy="give at least one")
    first = logs[0]
    names = [name for log in logs for name in log.joint_names]
    for log in logs[1:]:
        _require_equal_settings(first, log)
    if len(logs) == 1:
        return first
    source = "; ".join(dict.fromkeys(log.source for log in logs))
    if all(log.joint_names == first.joint_names for log in logs):
        parts = [part for log in logs for part in log.segments()]
        segment = np.repeat(np.arange(len(parts)), [part.num_rows for part in parts])
        names = channels(first).keys() - {"segment"}
        values = {name: np.concatenate([channels(part)[name] for part in parts]) for name in names}
        whole = replace(first, **values, segment=segment)
    elif len(set(names)) == len(names):
        classes = tuple(each for log in logs for each in log.given_classes)
        stated = classes if len(classes) == len(names) else ()
        whole = replace(_side_by_side(logs, source), joint_names=tuple(names), given_classes=stated)
    else:
        remedy = (
            "give each motor its own joint name, or give logs of the same joints in the same order"
        )
        raise LogError("some of the logs' joint names are equal", where=source, remedy=remedy)
    return checked(replace(whole, source=source))


def _require_equal_settings(first: MotorLog, log: MotorLog) -> None:
    problems = [
        f"{name} {getattr(log, name)!r}, another log has {getattr(first, name)!r}"
        for name in ("robot", "motor", "encoder", "gain_unit")
        if getattr(first, name) != getattr(log, name)
    ]
    registers = sorted(f"firmware.{name}" for name in first.firmware.keys() ^ log.firmware.keys())
    if unequal := registers + sorted((channels(first).keys() ^ channels(log).keys()) - {"segment"}):
        problems.append(f"only some of the logs have {', '.join(unequal)}")
    if problem := next(
        filter(None, [*problems, other_firmware(log.firmware, first.firmware)]), None
    ):
        remedy = "import all with the same channels and registers, or fit one at a time"
        raise LogError(problem, where=log.source, remedy=remedy)


def _side_by_side(logs: Sequence[MotorLog], source: str) -> MotorLog:
    rows = min(log.num_rows for log in logs)
    cut = [log.rows(slice(0, rows)) for log in logs]
    if any(log.segment_slices() != cut[0].segment_slices() for log in cut):
        problem = "the logs' segments begin at different rows"
        raise LogError(problem, where=source, remedy="record all motors with the same segments")
    names = channels(cut[0]).keys() & JOINT_SERIES.keys()
    return replace(
        cut[0],
        **{name: np.concatenate([channels(log)[name] for log in cut], axis=1) for name in names},
    )


EXCITED_STD = 1e-3  # standard deviation above which a command or an angle moves [rad]
MOVED_STD = 1e-2  # [rad]; of a joint without commands, above play and sway


def train_test_halves(log: MotorLog) -> tuple[MotorLog, MotorLog]:
    """Cut a log in two at the segment start nearest to its middle row; a log of one segment at its middle row."""
    starts = [part.start for part in log.segment_slices()[1:]]
    row = min(starts, key=lambda row: abs(row - log.num_rows / 2), default=log.num_rows // 2)
    return log.rows(slice(0, row)), log.rows(slice(row, None))


def excited_joints(log: MotorLog) -> np.ndarray:
    """Indices of the joints whose command has a standard deviation above 1 mrad."""
    return np.flatnonzero(np.std(log.position_target, axis=0) > EXCITED_STD)


def moved(log: MotorLog) -> np.ndarray:
    """(J,) whether a joint moves as commanded, or is moved by other joints by more than MOVED_STD."""
    pos, target = (np.std(values, axis=0) for values in (log.joint_pos, log.position_target))
    return (pos > EXCITED_STD) & ((target > EXCITED_STD) | (pos > MOVED_STD))


def static_joints(log: MotorLog) -> tuple[str, ...]:
    """Names of the joints whose angle has a standard deviation of at most 1 mrad."""
    return tuple(np.array(log.joint_names)[np.std(log.joint_pos, axis=0) <= EXCITED_STD].tolist())
