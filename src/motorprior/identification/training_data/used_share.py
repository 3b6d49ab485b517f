"""How much of a log a fit uses, and why it leaves out the rest."""

from __future__ import annotations

import numpy as np

from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TARGET, VEL, TrainingData

# Range of a command [rad] and speed [rad/s] that no joint exceeds in a second that counts as standing still
STILL_TARGET, STILL_VEL = 1e-3, 0.02


def used_share(data: TrainingData, preset: Preset) -> str:
    """A line: seconds of log that windows are made of, those left out with the reason, and those that stand still.

    The first `Preset.history` rows of a segment only bring the motors' hidden state up to date. Where physics is fitted
    first, windows lie end to end, and what is left of a segment is no window any more.
    """
    total = used = short = started = rest = still = 0
    segments_short = 0
    end_to_end = bool(preset.physics_first)
    for part in data.parts:
        rows = part.stop - part.start
        free = rows - preset.history - (preset.objective == "rollout")
        total += rows
        if free < preset.window:
            short, segments_short = short + rows, segments_short + 1
            continue
        fitted = free // preset.window * preset.window if end_to_end else free
        used, started, rest = used + fitted, started + rows - free, rest + free - fitted
        first = part.start + rows - free
        still += _still_rows(data.series[:, first : first + fitted], round(1.0 / preset.period))
    why = [
        f"{seconds} {reason}"
        for count, reason in (
            (short, f"in {segments_short} segments shorter than a window"),
            (started, "at the beginnings of segments, where hidden states settle"),
            (rest, "at their ends, less than a window"),
        )
        if (seconds := _seconds(count, preset)) != "0.0 s"
    ]
    said = f"fitted to {_seconds(used, preset)} of {_seconds(total, preset)} of log"
    said += f"; left out: {', '.join(why)}" if why else ""
    return said + (f"; {_seconds(still, preset)} of what is fitted stand still" if still else "")


def _seconds(rows: int, preset: Preset) -> str:
    return f"{rows * preset.period:.1f} s"


def _still_rows(series: np.ndarray, second: int) -> int:
    """Rows of (M, R, channels) in stretches of a ``second`` in which no command changes and no joint moves."""
    count = 0
    for first in range(0, series.shape[1], second):
        some = series[:, first : first + second]
        asked, moved = np.ptp(some[..., TARGET], axis=1).max(), np.abs(some[..., VEL]).max()
        count += some.shape[1] if asked < STILL_TARGET and moved < STILL_VEL else 0
    return count
