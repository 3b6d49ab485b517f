"""Checks of the rows of a log: their rate, its jitter, gaps, and rows that say nothing new."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.sensor_checks import encoder_step
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.resampling import repeated_rows

RATES = (5.0, 2e4)
"""Of logs of motors [Hz]; beyond them the time is in another unit."""
GAP_FACTOR = 5.0
MAX_JITTER = 0.5
IN_BURSTS = 0.02
"""Share of time steps that are gaps; so many are no lost rows."""
MAX_REPEATED = 0.05
MAX_STALE = 0.4
"""Of one joint; one that is read in turn with another repeats every second angle."""
LEAST_FAST = 0.05
"""Share of rows in which a joint must move fast to be judged."""
REACH = 5
FAST_STEPS = 2.0
"""A motion of fewer encoder steps per row repeats angles by itself."""


def rate(log: MotorLog) -> list[Finding]:
    """Rate of the rows [Hz]: 1 / median time step; an error outside RATES."""
    _, steps = time_steps(log)
    median = float(np.median(steps))
    found, (least, most) = 1.0 / median, RATES
    message = f"median step {1e3 * median:.3g} ms ({found:.4g} Hz), jitter {_jitter(steps):.2f} of the step"
    if 0.99 * least <= found <= 1.01 * most:  # clocks are not exact
        return [Finding("info", "rate", found, None, message, row=0)]
    message += f"; outside {least:g} to {most:g} Hz"
    remedy = (
        f'convert the time in the file, or say what its unit is {IN_MAP}: time = "s", "ms", "us" or "ns"; '
        "or record faster"
    )
    return [Finding("error", "rate", found, least if found < least else most, message, remedy, row=0)]


def jitter(log: MotorLog) -> list[Finding]:
    """(95th - 5th percentile of the time steps) / median, where it is more than a half; rows that come in bursts."""
    rows, steps = time_steps(log)
    median, spread = float(np.median(steps)), _jitter(steps)
    if spread <= MAX_JITTER:
        return []
    row = int(rows[np.argmax(np.abs(steps - median) > 0.5 * MAX_JITTER * median)])
    message = f"time steps spread by {spread:.2f} of their median {1e3 * median:.3g} ms, more than {MAX_JITTER}"
    remedy = "import it with a period: `motorprior logs import` then puts it on a uniform grid"
    if np.mean(steps > GAP_FACTOR * median) > IN_BURSTS:
        message += f"; rows come in bursts, {1.0 / float(steps.mean()):.4g} of them per second"
        remedy = (
            "these seem to be times of arrival: record the robot's own, or leave the column out of the file's map and "
            f"say rate = … in its place {IN_MAP}"
        )
    return [Finding("warning", "jitter", spread, MAX_JITTER, message, remedy, row=row)]


def _jitter(steps: np.ndarray) -> float:
    low, high = np.percentile(steps, [5, 95])
    return float((high - low) / np.median(steps))


def gap_rows(log: MotorLog) -> np.ndarray:
    """(G,) rows before which more than 5 median time steps of their own segment passed."""
    found = []
    for part in log.segment_slices():
        steps = np.diff(log.time[part])
        if len(steps):
            found.append(part.start + 1 + np.flatnonzero(steps > GAP_FACTOR * np.median(steps)))
    return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def gaps(log: MotorLog) -> list[Finding]:
    """Time steps of more than 5 medians of their segment."""
    rows = gap_rows(log)
    if not rows.size:
        return []
    steps = log.time[rows] - log.time[rows - 1]
    worst, first = int(np.argmax(steps)), int(rows[0])
    part = next(part for part in log.segment_slices() if rows[worst] < part.stop)
    bound = GAP_FACTOR * float(np.median(np.diff(log.time[part])))
    message = (
        f"{len(rows)} gaps longer than {GAP_FACTOR:g} median steps, the first before row {first}, "
        f"the longest {1e3 * steps[worst]:.3g} ms before row {rows[worst]}"
    )
    remedy = "find out why rows are lost; `motorprior logs import` begins a segment after each gap"
    return [Finding("warning", "gaps", float(steps[worst]), bound, message, remedy, row=first)]


def repeats(log: MotorLog) -> list[Finding]:
    """Share of row-to-row steps in which no measured angle changes, and the rate of those in which one does.

    A warning where that happens in the fastest quarter of the motion, too: at rest, and slower than an encoder step per
    row, angles repeat by themselves.
    """
    rows, steps = time_steps(log)
    repeated = repeated_rows(log)
    if not repeated.any():
        return []
    share, first = float(repeated[rows].mean()), int(np.argmax(repeated))
    fast_rows = fastest_rows(log)
    fast = float(repeated[fast_rows].mean()) if fast_rows.any() else 0.0
    described = f"{100 * share:.1f} % of the rows repeat the last angles, {100 * fast:.1f} % while moving fast"
    if fast <= MAX_REPEATED:
        return [Finding("info", "repeats", share, MAX_REPEATED, described, row=first)]
    message = f"{described} (bound {100 * MAX_REPEATED:g} %)"
    remedy = (
        "`motorprior replay` and `calibrate` leave them out; `logs import` does not: record a row per new reading, or "
        "delete the repeated rows from the file before"
    )
    return [
        Finding("warning", "repeats", share, MAX_REPEATED, message, remedy, row=first),
        *_true_rate(log, repeated, 1.0 / float(np.median(steps)), first),
    ]


def stale_joint(log: MotorLog) -> list[Finding]:
    """That joint whose own angle repeats most, where it moves fast and in all rows, though rows are new.

    Hosts poll joints one after another. A joint that sticks and slips repeats less where it is slow.
    """
    if log.num_joints == 1:
        return []
    found, rows, all_repeat = [], time_steps(log)[0], repeated_rows(log)
    for column, joint in enumerate(log.joint_names):
        alone = log.joint(column)
        repeated = repeated_rows(alone) & ~all_repeat
        share = float(repeated[rows].mean())
        if share > MAX_STALE and (fast := fastest_rows(alone)).mean() >= LEAST_FAST:
            found.append((min(share, float(repeated[fast].mean())), joint, repeated))
    share, joint, repeated = max(found, key=lambda each: each[0], default=(0.0, "", all_repeat))
    if share <= MAX_STALE:
        return []
    row = int(np.argmax(repeated))
    message = (
        f"{100 * share:.0f} % of the rows repeat {joint}'s last angle, more than {100 * MAX_STALE:g} %: its new ones "
        f"come at {_fresh_rate(log, repeated):.4g} Hz"
    )
    remedy = "joints seem to be read in turn: import with a period of one round, or read all in every row"
    return [Finding("warning", "stale", share, MAX_STALE, message, remedy, joint, row)]


def fastest_rows(log: MotorLog) -> np.ndarray:
    """Mask (T,) of the quarter of rows around which some angle moves fastest, none at rest or by single encoder steps.

    A row's way is the smaller of those in the five rows before it and the five after it.
    """
    moved = np.zeros(log.num_rows)
    for column in range(log.num_joints):
        least = FAST_STEPS * REACH * encoder_step(log.joint_pos[:, column])
        for part in log.segment_slices():
            way = np.abs(log.joint_pos[part, column][REACH:] - log.joint_pos[part, column][:-REACH])
            both = np.minimum(way[REACH:], way[:-REACH])
            middle = moved[part][REACH : REACH + len(both)]
            np.maximum(middle, np.where(both >= least, both, 0.0), out=middle)
    return moved >= np.percentile(moved[moved > 0.0], 75) if moved.any() else np.zeros(log.num_rows, dtype=bool)


def _fresh_rate(log: MotorLog, repeated: np.ndarray) -> float:
    """Rate of the rows that do not repeat [Hz]; 0 where no two of them follow each other."""
    _, steps = time_steps(log.rows(~repeated))
    return 1.0 / float(np.median(steps)) if steps.size else 0.0


def _true_rate(log: MotorLog, repeated: np.ndarray, polled: float, first: int) -> list[Finding]:
    """Rate of the rows that hold new angles [Hz], beside that of all rows."""
    true = _fresh_rate(log, repeated)
    if not true:
        return []
    message = f"new angles come at {true:.4g} Hz, rows at {polled:.4g} Hz"
    remedy = f"import it with a period of {1.0 / true:.3g} s or more"
    return [Finding("info", "true_rate", true, polled, message, remedy, row=first)]
