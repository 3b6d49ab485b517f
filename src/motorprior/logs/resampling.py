"""Resample logs to a uniform grid, and drop rows that repeat a measurement."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import CODES, JOINT_SERIES, MotorLog, channels, time_steps
from motorprior.logs.validity import checked

# Channels that are held until the next row; the others are interpolated
_HELD = ("position_target", "load_inertia", "stated_kp", "stated_kd", *CODES)
_MAX_ROWS = 50_000_000


def resample(log: MotorLog, period: float) -> MotorLog:
    """Put each segment on the grid t_k = t_0 + k·period, up to its last row.

    Commands are held (zero order); measurements are interpolated linearly. Drop repeated measurements first
    (`drop_repeats`), or the result moves in steps.

    Args:
        log: T rows.
        period: time step of the grid [s].

    Raises:
        LogError: a period that is not positive, is longer than a segment, or gives more than 50 million rows.
    """
    if not (math.isfinite(period) and period > 0.0):
        raise LogError(f"period {period} s, it must be positive", remedy="give seconds, for example 0.002")
    if log.duration / period > _MAX_ROWS:
        rows, steps = time_steps(log)
        gap = int(np.argmax(steps))
        problem = f"a period of {period:g} s gives more than {_MAX_ROWS} rows in {log.duration:g} s"
        problem += f"; the longest time step is {steps[gap]:g} s, before row {rows[gap]}"
        raise LogError(problem, where=log.source, remedy="begin a segment after the gap, or choose a longer period")
    parts = [_resample_segment(segment, period) for segment in log.segments()]
    return checked(replace(log, **{name: np.concatenate([part[name] for part in parts]) for name in parts[0]}))


def repeated_rows(log: MotorLog) -> np.ndarray:
    """Mask (T,) of rows whose measured angles all equal those of the previous row of the same segment."""
    repeated = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        repeated[part.start + 1 : part.stop] = np.all(np.diff(log.joint_pos[part], axis=0) == 0.0, axis=1)
    return repeated


def drop_repeats(log: MotorLog) -> MotorLog:
    """Keep the first row of every run of equal measurements.

    A host that polls faster than the robot answers logs the same angles several times, which makes velocities zero.
    Only for logs of hardware: exact repeats in simulation are real.

    Raises:
        LogError: a segment has fewer than 2 different measurements.
    """
    kept = log.rows(~repeated_rows(log))
    for segment in kept.segments():
        if segment.num_rows < 2:
            problem = f"all measured angles of the segment at {segment.time[0]:g} s are equal"
            raise LogError(problem, where=log.source, remedy="check the encoders, or remove the segment")
    return kept


def _resample_segment(segment: MotorLog, period: float) -> dict[str, np.ndarray]:
    start, end = float(segment.time[0]), float(segment.time[-1])
    count = math.floor((end - start) / period * (1.0 + 1e-12) + 1e-6) + 1
    if count < 2:
        problem = f"period {period} s is longer than the segment at {start:g} s, which lasts {end - start:g} s"
        raise LogError(problem, where=segment.source, remedy="choose a shorter period")
    grid = start + period * np.arange(count)
    held = np.searchsorted(segment.time, grid + 1e-6 * period, side="right") - 1
    result = {"time": grid}
    for name, value in channels(segment).items():
        if name in _HELD:
            result[name] = value[held]
        elif name in JOINT_SERIES or name == "base_orientation":
            result[name] = np.stack([np.interp(grid, segment.time, column) for column in value.T], axis=1)
    return result
