"""Rows on a uniform grid, and rows without repeated measurements."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import CODES, JOINT_SERIES, MotorLog, channels, time_steps
from motorprior.logs.validity import checked

HELD = ("position_target", "load_inertia", "stated_kp", "stated_kd", *CODES)
"""Channels that keep their value until the next row; the others are interpolated."""
MAX_ROWS = 50_000_000


def resample(log: MotorLog, period: float) -> MotorLog:
    """Put each segment on the grid t_k = t_0 + k·period, up to its last row.

    The command is held (zero order), as the motor saw it; measurements are interpolated linearly. Drop
    repeated measurements first (`drop_repeats`), or the result moves in steps.

    Args:
        log: T rows.
        period: step of the grid [s].

    Raises:
        LogError: a period that is not positive and finite, longer than a segment, or that makes more than
            50 million rows.
    """
    if not (math.isfinite(period) and period > 0.0):
        raise LogError(f"period {period} s, it must be positive", remedy="give seconds, for example 0.002")
    if log.duration / period > MAX_ROWS:
        rows, steps = time_steps(log)
        gap = int(np.argmax(steps))
        raise LogError(
            f"row {rows[gap]} comes {steps[gap]:g} s after the row before; a row every {period:g} s makes more than "
            f"{MAX_ROWS} rows of {log.duration:g} s",
            where=log.source,
            remedy="start a new segment after the gap, or choose a longer period",
        )
    parts = [_resample_segment(segment, period) for segment in log.segments()]
    merged = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return checked(replace(log, **merged))


def repeated_rows(log: MotorLog) -> np.ndarray:
    """Mask (T,) of rows whose measured angles all equal those of the previous row of the same segment."""
    repeated = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        repeated[part.start + 1 : part.stop] = np.all(np.diff(log.joint_pos[part], axis=0) == 0.0, axis=1)
    return repeated


def drop_repeats(log: MotorLog) -> MotorLog:
    """Keep the first row of every run of equal measurements.

    A host that polls faster than the robot answers writes the same angles several times; such rows say
    nothing new and make velocities zero. Meant for logs of hardware: an exact zero velocity in a simulated
    log is information, and would be dropped as well.

    Raises:
        LogError: a segment has fewer than 2 different measurements.
    """
    kept = log.rows(~repeated_rows(log))
    for segment in kept.segments():
        if segment.num_rows < 2:
            raise LogError(
                f"all measured angles of the segment at {segment.time[0]:g} s are the same",
                where=log.source,
                remedy="check the encoders, or leave the segment out",
            )
    return kept


def _resample_segment(segment: MotorLog, period: float) -> dict[str, np.ndarray]:
    start, end = float(segment.time[0]), float(segment.time[-1])
    count = math.floor((end - start) / period * (1.0 + 1e-12) + 1e-6) + 1
    if count < 2:
        raise LogError(
            f"period {period} s is longer than the segment at {start:g} s, which lasts {end - start:g} s",
            where=segment.source,
            remedy="choose a shorter period",
        )
    grid = start + period * np.arange(count)
    held = np.searchsorted(segment.time, grid + 1e-6 * period, side="right") - 1
    result = {"time": grid}
    for name, value in channels(segment).items():
        if name in HELD:
            result[name] = value[held]
        elif name in JOINT_SERIES or name == "base_orientation":
            result[name] = np.stack([np.interp(grid, segment.time, column) for column in value.T], axis=1)
    return result
