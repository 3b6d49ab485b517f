"""Interquartile means, intervals and permutation tests for few policies, after Agarwal et al., NeurIPS 2021.

Scores are (policies, draws): a row per trained policy, a column per sample of motors; NaN if undefined. Intervals
resample policies and samples, the same samples for all rows. (The published bootstrap resamples policies within each
task, as if the walks of one policy were independent; its intervals are too narrow.) p-values are exact permutation
tests over policies, since bootstrap tails of eight policies are too light.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

BATCHES, BATCH = 2, 1000  # resamples of an interval
LEVEL = 0.95  # of intervals
MAX_PERMUTATIONS = 20_000  # that a test enumerates; if there are more, it samples this many
_SEED = 0x57A7
Statistic = Callable[[np.ndarray], np.ndarray]  # (..., scores) -> (...) of the finite scores; NaN if there are none
Axes = tuple[str, str]  # names of rows and columns; those of one name are resampled together
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """Attributes: value of a statistic; low and high ends of its 95 % interval, NaN if undefined."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """One condition compared with another in the same environment.

    Attributes:
        difference: of the statistic, one minus the other.
        p: two-sided, see `permutation_p`.
    """

    difference: Estimate
    p: float


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
    """A statistic of (policies, draws) scores with its interval."""
    return _interval(statistic, ("policy", "draw"), [(scores, ("policy", "draw"))])


def compare_scores(one: np.ndarray, other: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare (policies, draws) scores of two conditions that walk the same samples of motors in an environment."""
    tables = [(one, ("policy", "draw")), (other, ("other", "draw"))]
    difference = _interval(statistic, ("draw", "policy", "other"), tables)
    return Comparison(difference, permutation_p(statistic(one), statistic(other)))


def compare_on_robots(adapted: np.ndarray, others: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare policies that each walk on one robot with policies that walk on all of these robots.

    The interval resamples robots, the same for both, and the other policies. The test first subtracts each robot's
    effect: score of the others on it minus their score on all. It is estimated from one walk per other policy, so p is
    approximate, and too large if adapted policies never fall and others fall on some robots.

    Args:
        adapted: (robots, draws) scores of the policy of every robot.
        others: (policies, robots) scores, in the same order of robots.
        statistic: of the difference.
    """
    tables = [(adapted, ("robot", "draw")), (others, ("policy", "robot"))]
    difference = _interval(statistic, ("robot", "policy", "draw"), tables)
    robot_effect = statistic(others.T) - statistic(others.ravel())
    return Comparison(difference, permutation_p(statistic(adapted) - robot_effect, statistic(others)))


def _interval(statistic: Statistic, axes: tuple[str, ...], tables: list[tuple[np.ndarray, Axes]]) -> Estimate:
    """The statistic of the first table, minus that of a second, with its bootstrap interval; axes in sampling order."""
    sizes = {axis: size for scores, both in tables for axis, size in zip(both, scores.shape, strict=True)}

    def value(indices: Mapping[str, np.ndarray]) -> np.ndarray:
        first, *second = (
            statistic(scores[indices[rows][:, :, None], indices[columns][:, None, :]].reshape(len(indices[rows]), -1))
            for scores, (rows, columns) in tables
        )
        return first - second[0] if second else first

    rng = np.random.default_rng(_SEED)
    sampled = [{a: rng.integers(sizes[a], size=(BATCH, sizes[a])) for a in axes} for _ in range(BATCHES)]
    found = np.concatenate([value(indices) for indices in sampled])
    (actual,) = value({axis: np.arange(sizes[axis])[None] for axis in axes})
    side, finite = 0.5 * (1.0 - LEVEL), found[np.isfinite(found)]
    # no interval if so many resamples are undefined that an end may be among them
    if not np.isfinite(actual) or len(found) - len(finite) > side * len(found):
        return Estimate(float(actual), float("nan"), float("nan"))
    low, high = np.quantile(finite, [side, 1.0 - side])
    return Estimate(float(actual), float(low), float(high))


def permutation_p(one: np.ndarray, other: np.ndarray) -> float:
    """Two-sided permutation p of no difference between the (policies,) scores of two conditions (Pitman 1937).

    Share of all assignments of the scores to the conditions whose means differ by at least as much, without NaN. Exact
    for few policies of any distribution: at least 2 / 12870 for eight against eight, 1 / 3 for two against two; 1
    for a single policy.
    """
    from scipy.stats import permutation_test  # here: it takes a second to import

    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    if min(len(one), len(other)) < 2:
        return 1.0

    def difference(a: np.ndarray, b: np.ndarray, axis: int) -> np.ndarray:
        return np.abs(a.mean(axis=axis) - b.mean(axis=axis))

    found = permutation_test(
        (one, other), difference, vectorized=True, n_resamples=MAX_PERMUTATIONS, alternative="greater", rng=_SEED
    )
    return float(found.pvalue)


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P-values corrected by Holm's step-down procedure, by the same keys."""
    ordered = sorted(p_values, key=p_values.__getitem__)
    steps = [min(1.0, (len(ordered) - rank) * p_values[key]) for rank, key in enumerate(ordered)]
    corrected = dict(zip(ordered, np.maximum.accumulate(steps).tolist(), strict=True)) if ordered else {}
    return {key: corrected[key] for key in p_values}
