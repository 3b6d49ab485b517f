"""Estimates over benches, and permutation tests, for few policies per bench.

Scores are (benches, policies, draws): a bench per own draw of motors, robots, floors and pushes; a row per trained
policy; a column per sample of motors; NaN if undefined. A bench is a random effect: intervals are those of the mean of
the benches' statistics, so that they contain the differences between benches, policies and samples. Those of a single
bench are over its samples: they contain no difference between trainings.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.special import stdtrit

LEVEL = 0.95  # of intervals
PERMUTATIONS = 20_000  # random assignments of a test
_SEED = 0x57A7
Statistic = Callable[[np.ndarray], np.ndarray]  # (..., scores) -> (...) of the finite scores; NaN if there are none
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """Value of a statistic, and its 95 % interval, NaN if undefined."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """One condition compared with another in the same environment."""

    difference: Estimate  # of the statistic, one minus the other
    p: float  # two-sided, see `permutation_p`


def iqms(scores: np.ndarray) -> np.ndarray:
    """(...) interquartile means of (..., scores): of n finite ones without the n/4 lowest and n/4 highest.

    n/4 is rounded down, as in `scipy.stats.trim_mean`.
    """
    ordered = np.sort(scores, axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    rank = np.arange(scores.shape[-1])
    return _mean_of(ordered, (rank >= count // 4) & (rank < count - count // 4))


def means(scores: np.ndarray) -> np.ndarray:
    """(...) means of the finite of (..., scores)."""
    return _mean_of(scores, np.isfinite(scores))


def _mean_of(scores: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(...) means of the chosen of (..., scores); NaN if none is."""
    count = chosen.sum(axis=-1)
    return np.where(chosen, scores, 0.0).sum(axis=-1) / np.where(count > 0, count, np.nan)


def estimate(scores: np.ndarray, statistic: Statistic = iqms) -> Estimate:
    """Mean over benches of the statistic of a bench's walks, with its interval; of a single bench over its samples."""
    return _interval(_units(scores, statistic))


def compare_scores(one: np.ndarray, other: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare scores of two conditions on the same benches and samples."""
    difference = _interval(_units(one, statistic) - _units(other, statistic))
    return Comparison(difference, permutation_p(statistic(one), statistic(other)))


def _units(scores: np.ndarray, statistic: Statistic) -> np.ndarray:
    """A value per bench; of a single bench, one per sample."""
    return statistic(scores.reshape(len(scores), -1) if len(scores) > 1 else scores[0].T)


def _interval(values: np.ndarray) -> Estimate:
    """Mean ± t·s/√n of n values (Student 1908), t with n - 1 degrees of freedom."""
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return Estimate(float(values[0]) if len(values) else float("nan"), float("nan"), float("nan"))
    mean, error = float(values.mean()), float(values.std(ddof=1)) / np.sqrt(len(values))
    reach = float(stdtrit(len(values) - 1, 0.5 * (1.0 + LEVEL))) * error
    return Estimate(mean, mean - reach, mean + reach)


def permutation_p(one: np.ndarray, other: np.ndarray) -> float:
    """Two-sided permutation p of no difference between the (benches, policies) scores of two conditions (Pitman 1937).

    Share of random assignments of the scores of each bench to the conditions, the actual one included, whose mean
    difference over benches is at least as large, without NaN: at least 1 / 20 001; 1 for a single policy.
    """
    both = np.concatenate([one, other], axis=1)
    if both.shape[1] < 3:
        return 1.0
    first = np.arange(both.shape[1]) < one.shape[1]
    rng = np.random.default_rng(_SEED)
    order = rng.permuted(np.broadcast_to(np.arange(both.shape[1]), (PERMUTATIONS, *both.shape)), axis=-1)
    shuffled = np.concatenate([both[None], np.take_along_axis(both[None], order, axis=-1)])
    found = np.abs(means(means(shuffled[..., first]) - means(shuffled[..., ~first])))
    return float(np.mean(found >= found[0] - 1e-12))


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P-values corrected by Holm's step-down procedure, by the same keys."""
    ordered = sorted(p_values, key=p_values.__getitem__)
    steps = [min(1.0, (len(ordered) - rank) * p_values[key]) for rank, key in enumerate(ordered)]
    corrected = dict(zip(ordered, np.maximum.accumulate(steps).tolist(), strict=True)) if ordered else {}
    return {key: corrected[key] for key in p_values}
