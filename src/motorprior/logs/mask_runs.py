"""Runs of consecutive rows of a log that a mask selects; no run crosses the end of a segment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.logs.motor_log import MotorLog
from motorprior.signals import runs_of_true


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of rows: first row and row after the last, each (R,)."""

    starts: np.ndarray
    stops: np.ndarray

    def durations(self, log: MotorLog) -> np.ndarray:
        """(R,) time from first to last row [s]."""
        return log.time[self.stops - 1] - log.time[self.starts]

    def where(self, chosen: np.ndarray) -> Runs:
        """The runs that a mask (R,) selects."""
        return Runs(self.starts[chosen], self.stops[chosen])

    def highest(self, values: np.ndarray) -> np.ndarray:
        """(R,) maximum of ``values`` (T,) in each run."""
        return self._reduced(np.maximum, values)

    def lowest(self, values: np.ndarray) -> np.ndarray:
        """(R,) minimum of ``values`` (T,) in each run."""
        return self._reduced(np.minimum, values)

    def _reduced(self, how: np.ufunc, values: np.ndarray) -> np.ndarray:
        if not self.starts.size:
            return np.zeros(0)
        bounds = np.column_stack([self.starts, self.stops]).ravel()
        return how.reduceat(np.append(values, values[-1]), bounds)[::2]


def runs_of(log: MotorLog, mask: np.ndarray) -> Runs:
    """Maximal runs of rows that a mask (T,) selects."""
    rows = np.concatenate([part.start + runs_of_true(mask[part]) for part in log.segment_slices()])
    return Runs(rows[:, 0], rows[:, 1])


def unchanged_runs(log: MotorLog, values: np.ndarray) -> Runs:
    """Runs of at least two rows with equal ``values`` (T,)."""
    rows = np.concatenate([part.start + runs_of_true(np.diff(values[part]) == 0.0) for part in log.segment_slices()])
    return Runs(rows[:, 0], rows[:, 1] + 1)
