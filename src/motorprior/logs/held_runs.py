"""Runs of rows in which something holds, and what another channel does meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.logs.motor_log import MotorLog


@dataclass(frozen=True, eq=False)
class Runs:
    """Stretches of consecutive rows of a log, none across a segment's end; first row and row after the last, (R,)."""

    starts: np.ndarray
    stops: np.ndarray

    def durations(self, log: MotorLog) -> np.ndarray:
        """(R,) [s] from first to last row."""
        return log.time[self.stops - 1] - log.time[self.starts]

    def where(self, chosen: np.ndarray) -> Runs:
        """Those that a mask (R,) selects."""
        return Runs(self.starts[chosen], self.stops[chosen])

    def highest(self, values: np.ndarray) -> np.ndarray:
        """(R,) largest of ``values`` (T,) in each."""
        return self._reduced(np.maximum, values)

    def lowest(self, values: np.ndarray) -> np.ndarray:
        """(R,) smallest of ``values`` (T,) in each."""
        return self._reduced(np.minimum, values)

    def _reduced(self, how: np.ufunc, values: np.ndarray) -> np.ndarray:
        if not self.starts.size:
            return np.zeros(0)
        bounds = np.column_stack([self.starts, self.stops]).ravel()
        return how.reduceat(np.append(values, values[-1]), bounds)[::2]


def runs_of(log: MotorLog, mask: np.ndarray) -> Runs:
    """The longest runs of rows that a mask (T,) selects."""
    first = np.zeros(log.num_rows + 1, dtype=bool)
    first[[part.start for part in log.segment_slices()]] = True
    padded = np.concatenate([[False], mask, [False]])
    starts = np.flatnonzero(mask & (~padded[:-2] | first[:-1]))
    stops = np.flatnonzero(mask & (~padded[2:] | first[1:])) + 1
    return Runs(starts, stops)


def unchanged_runs(log: MotorLog, values: np.ndarray) -> Runs:
    """Runs of two rows or more in which ``values`` (T,) stay the same."""
    held = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        same = np.diff(values[part]) == 0.0
        held[part.start + 1 : part.stop] = same
    later = runs_of(log, held)
    return Runs(later.starts - 1, later.stops)
