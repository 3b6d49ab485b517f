"""Checks of the time column and of repeated rows."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.jumps import encoder_step
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.resampling import repeated_rows

RATES = (5.0, 2e4)  # of motor logs [Hz]; other rates mean another unit of time
GAP_FACTOR = 5.0
MAX_JITTER = 0.5


def rate(log: MotorLog) -> list[Finding]:
    """Rate [Hz], 1 / median time step, and jitter, (95th - 5th percentile of the time steps) / median."""
    rows, steps = time_steps(log)
    median = float(np.median(steps))
    hertz, (lowest, highest) = 1.0 / median, RATES
    jitter = float(np.subtract(*np.percentile(steps, [95, 5]))) / median
    message = f"median time step {1e3 * median:.3g} ms ({hertz:.4g} Hz), jitter {jitter:.2f} of the step"
    if not 0.99 * lowest <= hertz <= 1.01 * highest:
        message += f"; outside {lowest:g} to {highest:g} Hz"
        remedy = f'convert the time in the file, or state its unit {IN_MAP}: time = "s", "ms", "us" or "ns"'
        return [Finding("error", "rate", hertz, message, f"{remedy}; or record faster", row=0)]
    found = [Finding("info", "rate", hertz, message, row=0)]
    if jitter > MAX_JITTER:
        row = int(rows[np.argmax(np.abs(steps - median) > 0.5 * MAX_JITTER * median)])
        message = f"time steps vary by {jitter:.2f} of their median {1e3 * median:.3g} ms, more than {MAX_JITTER}"
        remedy = "import with --period, which resamples the log; if these are times of arrival, record the robot's "
        remedy += f"time, or replace the time by rate = … {IN_MAP}"
        found.append(Finding("warning", "jitter", jitter, message, remedy, row=row))
    return found


def gap_rows(log: MotorLog) -> np.ndarray:
    """(G,) rows before which more than 5 median time steps of their segment passed."""
    found = [np.zeros(0, dtype=np.intp)]
    for part in log.segment_slices():
        steps = np.diff(log.time[part])
        if len(steps):
            found.append(part.start + 1 + np.flatnonzero(steps > GAP_FACTOR * np.median(steps)))
    return np.concatenate(found)


def gaps(log: MotorLog) -> list[Finding]:
    """Time steps above 5 medians of their segment."""
    rows = gap_rows(log)
    if not rows.size:
        return []
    steps = log.time[rows] - log.time[rows - 1]
    longest, first = int(np.argmax(steps)), int(rows[0])
    message = f"{len(rows)} gaps longer than {GAP_FACTOR:g} median steps, the first before row {first}, the longest "
    message += f"{1e3 * steps[longest]:.3g} ms before row {rows[longest]}"
    remedy = "find out why rows are lost; `motorprior logs import` begins a segment after each gap"
    return [Finding("warning", "gaps", float(steps[longest]), message, remedy, row=first)]


def repeats(log: MotorLog) -> list[Finding]:
    """Angles that repeat in fast motion: those of all joints (rows without new readings), or of one (read in turn).

    Static joints, and joints that move slower than an encoder step per row, repeat their angles in any log.
    """
    whole, moved = repeated_rows(log), [_displacements(angle) for angle in log.joint_pos.T]
    found = []
    for joint in (None, *log.joint_names):
        repeated, way, bound = whole, np.max(moved, axis=0), 0.05
        if joint is not None:
            column = log.joint_names.index(joint)
            repeated, way, bound = repeated_rows(log.joint(column)) & ~whole, moved[column], 0.4
        fast = way >= np.percentile(way[way > 0.0], 75) if way.any() else way > 0.0
        if fast.sum() < 20 or min(share := float(repeated[fast].mean()), repeated.mean()) <= bound:
            continue
        fresh = float(np.median(time_steps(log.rows(~repeated))[1]))
        message = (
            f"{100 * share:.0f} % of the rows repeat the last angle of {joint or 'all joints'} in fast motion (bound "
            f"{100 * bound:g} %): new readings every {1e3 * fresh:.3g} ms, rows every {1e3 * log.period:.3g} ms"
        )
        remedy = "record one row per new reading of all joints, or import with --period no shorter than their period"
        found.append(Finding("warning", "repeats", share, message, remedy, joint, int(np.argmax(repeated))))
    return found


def _displacements(angle: np.ndarray) -> np.ndarray:
    """(T,) smaller displacement of a joint in the 5 rows before and after, 0 below 10 encoder steps."""
    way, moved = np.abs(angle[5:] - angle[:-5]), np.zeros(len(angle))
    moved[5:-5] = np.minimum(way[5:], way[:-5])
    return np.where(moved >= 10.0 * encoder_step(angle), moved, 0.0)
