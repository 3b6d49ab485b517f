"""Running mean and variance of observations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.compiled import njit

CONSTANT_STD = 1e-6  # an observation that varies less counts as constant and is not scaled


@njit(cache=True)
def update_stats(observation: np.ndarray, count: int, mean: np.ndarray, m2: np.ndarray) -> None:
    """Add one observation x to mean and m2 = Σ (x - mean)² of ``count`` earlier ones, in place.

    d = x - mean, mean += d / n, m2 += d (x - mean) with the new mean (Welford 1962).
    """
    for i in range(observation.shape[0]):
        shift = observation[i] - mean[i]
        mean[i] += shift / (count + 1)
        m2[i] += shift * (observation[i] - mean[i])


@dataclass(frozen=True, eq=False)
class RunningStats:
    """Count of observations, their (observation,) mean and (observation,) m2 = Σ (x - mean)²."""

    count: int
    mean: np.ndarray
    m2: np.ndarray

    @classmethod
    def empty(cls, size: int) -> RunningStats:
        """Statistics of no observations."""
        return cls(0, np.zeros(size), np.zeros(size))

    def merge(self, other: RunningStats) -> RunningStats:
        """Statistics of both together (Chan, Golub, LeVeque 1983).

        d = mean_b - mean_a, mean = mean_a + d n_b / n, M2 = M2_a + M2_b + d² n_a n_b / n.
        """
        if other.count == 0:
            return self
        count = self.count + other.count
        shift = other.mean - self.mean
        mean = self.mean + shift * (other.count / count)
        m2 = self.m2 + other.m2 + np.square(shift) * (self.count * other.count / count)
        return RunningStats(count, mean, m2)

    def std(self) -> np.ndarray:
        """Population standard deviation; 1 where an observation is constant or there is none."""
        std = np.sqrt(self.m2 / max(self.count, 1))
        return np.where(std > CONSTANT_STD, std, 1.0)
