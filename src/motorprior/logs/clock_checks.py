"""Checks of the rows of a log: their rate, gaps between them, and rows that say nothing new."""

from __future__ import annotations

import numpy as np

from motorprior.logs.findings import Finding
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.resampling import repeated_rows

GAP_FACTOR = 5.0
MAX_JITTER = 0.5
MAX_REPEATED = 0.05


def rate(log: MotorLog) -> list[Finding]:
    """Median rate [Hz], and jitter = (95th - 5th percentile of the time steps) / median."""
    _, steps = time_steps(log)
    median = float(np.median(steps))
    low, high = np.percentile(steps, [5, 95])
    jitter = float((high - low) / median)
    described = f"median step {1e3 * median:.3g} ms ({1.0 / median:.4g} Hz), jitter {jitter:.2f} of the step"
    if jitter <= MAX_JITTER:
        return [Finding("info", "rate", 1.0 / median, None, described)]
    return [
        Finding(
            "warning",
            "rate",
            jitter,
            MAX_JITTER,
            f"{described}, more than {MAX_JITTER}",
            "resample on a uniform grid before differentiating",
        )
    ]


def gaps(log: MotorLog) -> list[Finding]:
    """Time steps of more than 5 medians within a segment."""
    rows, steps = time_steps(log)
    bound = GAP_FACTOR * float(np.median(steps))
    late = steps > bound
    if not late.any():
        return []
    worst = int(np.argmax(steps))
    return [
        Finding(
            "warning",
            "gaps",
            float(steps[worst]),
            bound,
            f"{int(late.sum())} gaps longer than {1e3 * bound:.3g} ms (5 median steps), the longest "
            f"{1e3 * steps[worst]:.3g} ms before row {rows[worst]}",
            "split the log into segments at long gaps",
            row=int(rows[worst]),
        )
    ]


def repeats(log: MotorLog) -> list[Finding]:
    """Share of row-to-row steps in which no measured angle changes."""
    rows, _ = time_steps(log)
    repeated = repeated_rows(log)
    if not repeated.any():
        return []
    share = float(repeated[rows].mean())
    return [
        Finding(
            "warning" if share > MAX_REPEATED else "info",
            "repeats",
            share,
            MAX_REPEATED,
            f"{100 * share:.1f} % of the rows repeat the last angles (bound {100 * MAX_REPEATED:g} %)",
            "drop repeats before differentiating",
            row=int(np.argmax(repeated)),
        )
    ]
