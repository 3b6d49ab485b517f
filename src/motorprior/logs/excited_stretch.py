"""The part of a log on which costly checks look: uniform in time, and that in which the command moves most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.logs.motor_log import MotorLog
from motorprior.logs.resampling import repeated_rows, resample

MAX_SAMPLES = 20_000
MIN_SAMPLES = 20


@dataclass(frozen=True, eq=False)
class Stretch:
    """Part of a log on a uniform grid.

    Attributes:
        log: the part.
        period: of its grid [s].
        row: of the whole log at which it begins.
    """

    log: MotorLog
    period: float
    row: int


def excited_stretch(log: MotorLog) -> Stretch | None:
    """At most 20 000 samples of the longest segment, or None where it is too short to say anything."""
    part = max(log.segment_slices(), key=lambda part: log.time[part.stop - 1] - log.time[part.start])
    segment = log.rows(part)
    steps = np.diff(segment.rows(~repeated_rows(segment)).time)
    period = float(np.median(steps)) if steps.size else 0.0
    if period <= 0.0 or segment.duration < MIN_SAMPLES * period:
        return None
    rows = max(2, round(MAX_SAMPLES * period / segment.period))
    starts = range(0, max(1, segment.num_rows - rows + 1), rows)
    start = max(starts, key=lambda first: float(np.std(segment.position_target[first : first + rows], axis=0).sum()))
    stretch = segment.rows(slice(start, start + rows))
    if stretch.duration < MIN_SAMPLES * period or stretch.duration > 2.0 * MAX_SAMPLES * period:
        return None
    return Stretch(resample(stretch, period), period, part.start + start)
