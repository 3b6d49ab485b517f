"""Interquartile means, intervals and permutation tests for few policies, after Agarwal et al., NeurIPS 2021.

Scores are (seeds, draws): a row per trained policy, a column per sample of motors; NaN if undefined. Intervals resample
policies and samples, the same samples for all rows. (The published bootstrap resamples policies within each task, as if
the walks of one policy were independent; its intervals are too narrow.) p-values are exact permutation tests over
policies, since bootstrap tails of eight policies are too light.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb
from typing import TypeVar

import numpy as np

RESAMPLES = 2000
LEVEL = 0.95  # of intervals
MAX_PERMUTATIONS = 20_000  # that a test enumerates; if there are more, it samples this many
_SEED = 0x57A7
_CHUNK = 1000  # resamples in memory at a time
Statistic = Callable[[np.ndarray], np.ndarray]  # (..., scores) -> (...) of the finite scores; NaN if there are none
Key = TypeVar("Key", bound=Hashable)
Sampled = Callable[[np.random.Generator, int], np.ndarray]  # (generator, count) -> (count,) resampled statistics


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
        p: two-sided, see `permutation_p` and, of pairs, `sign_p`.
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
    middle = (rank >= count // 4) & (rank < count - count // 4)
    return _mean_of(ordered, middle)


def means(scores: np.ndarray) -> np.ndarray:
    """(...) means of the finite of (..., scores)."""
    return _mean_of(scores, np.isfinite(scores))


def estimate(scores: np.ndarray, statistic: Statistic = iqms, resamples: int = RESAMPLES) -> Estimate:
    """A statistic of (seeds, draws) scores with its interval.

    Raises:
        ValueError: no scores.
    """
    _require_scores(scores)

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        return statistic(_resampled(scores, _indices(rng, count, len(scores)), _indices(rng, count, scores.shape[1])))

    return _with_interval(statistic(scores.ravel()), _bootstrap(sampled, resamples))


def compare_scores(
    one: np.ndarray, other: np.ndarray, shared: bool = True, statistic: Statistic = iqms, resamples: int = RESAMPLES
) -> Comparison:
    """Compare (seeds, draws) scores of two conditions in an environment.

    Args:
        one: of the first condition.
        other: of the second.
        shared: whether both walked the same samples of motors, which are then resampled together; seeds never are.
        statistic: of the difference; the test uses the statistic of each policy.
        resamples: of the bootstrap.

    Raises:
        ValueError: no scores, or different numbers of shared samples.
    """
    _require_scores(one, other)
    if shared and one.shape[1] != other.shape[1]:
        raise ValueError(f"{one.shape[1]} draws against {other.shape[1]}")

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        columns = _indices(rng, count, one.shape[1])
        others = columns if shared else _indices(rng, count, other.shape[1])
        mine, theirs = (_indices(rng, count, len(each)) for each in (one, other))
        return statistic(_resampled(one, mine, columns)) - statistic(_resampled(other, theirs, others))

    value = statistic(one.ravel()) - statistic(other.ravel())
    difference = _with_interval(value, _bootstrap(sampled, resamples))
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

    Raises:
        ValueError: no scores, or another number of robots.
    """
    _require_scores(adapted, others)
    if len(adapted) != others.shape[1]:
        raise ValueError(f"{len(adapted)} robots against {others.shape[1]}")

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        robots, policies = _indices(rng, count, len(adapted)), _indices(rng, count, len(others))
        mine = _resampled(adapted, robots, _indices(rng, count, adapted.shape[1]))
        return statistic(mine) - statistic(_resampled(others, policies, robots))

    value = statistic(adapted.ravel()) - statistic(others.ravel())
    robot_effect = statistic(others.T) - statistic(others.ravel())
    p = permutation_p(statistic(adapted) - robot_effect, statistic(others))
    difference = _with_interval(value, _bootstrap(sampled, RESAMPLES))
    return Comparison(difference, p)


def compare_pairs(one: np.ndarray, other: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare two conditions with one policy per robot each, on the same robots.

    The interval resamples robots and samples, the same for both. The test permutes the signs of the robots'
    differences: with eight robots p is at least 2 / 256.

    Args:
        one: (robots, draws) scores of the first condition.
        other: (robots, draws) scores of the second.
        statistic: of the difference.

    Raises:
        ValueError: no scores, or different numbers of robots or draws.
    """
    _require_scores(one, other)
    if one.shape != other.shape:
        raise ValueError(f"{one.shape} robots and draws against {other.shape}")

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        robots, draws = _indices(rng, count, len(one)), _indices(rng, count, one.shape[1])
        return statistic(_resampled(one, robots, draws)) - statistic(_resampled(other, robots, draws))

    difference = _with_interval(statistic(one.ravel()) - statistic(other.ravel()), _bootstrap(sampled, RESAMPLES))
    return Comparison(difference, sign_p(statistic(one) - statistic(other)))


def _mean_of(scores: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(...) means of the chosen of (..., scores); NaN if none is."""
    count = chosen.sum(axis=-1)
    return np.where(chosen, scores, 0.0).sum(axis=-1) / np.where(count > 0, count, np.nan)


def _require_scores(*scores: np.ndarray) -> None:
    if not all(each.size for each in scores):
        raise ValueError("no scores")


def _indices(rng: np.random.Generator, count: int, size: int) -> np.ndarray:
    return rng.integers(size, size=(count, size))


def _resampled(scores: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(count, seeds · draws) scores of every resample."""
    return scores[rows[:, :, None], columns[:, None, :]].reshape(len(rows), -1)


def _bootstrap(sampled: Sampled, resamples: int) -> np.ndarray:
    """(resamples,) values."""
    rng = np.random.default_rng(_SEED)
    counts = [min(_CHUNK, resamples - start) for start in range(0, resamples, _CHUNK)]
    return np.concatenate([sampled(rng, count) for count in counts])


def _with_interval(value: float | np.ndarray, found: np.ndarray) -> Estimate:
    side, finite = 0.5 * (1.0 - LEVEL), found[np.isfinite(found)]
    # no interval if so many resamples are undefined that an end may be among them
    if not np.isfinite(value) or len(found) - len(finite) > side * len(found):
        return Estimate(float(value), float("nan"), float("nan"))
    low, high = np.quantile(finite, [side, 1.0 - side])
    return Estimate(float(value), float(low), float(high))


def permutation_p(one: np.ndarray, other: np.ndarray) -> float:
    """Two-sided permutation p of no difference between two conditions (Pitman 1937).

    Share of all assignments of the (policies,) scores to the conditions whose means differ by at least as much, without
    NaN. Exact for few policies of any distribution: at least 2 / 12870 for eight against eight, 1 / 3 for two against
    two; 1 without scores.
    """
    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    if not len(one) or not len(other):
        return 1.0
    scores, taken = np.concatenate([one, other]), _splits(len(one), len(other))
    differences = (taken @ scores) / len(one) - (~taken @ scores) / len(other)
    threshold = abs(one.mean() - other.mean()) * (1.0 - 1e-9) - 1e-12  # sums round differently
    return float(np.mean(np.abs(differences) >= threshold))


@lru_cache
def _splits(first: int, second: int) -> np.ndarray:
    """(assignments, first + second) masks of the first condition, at most MAX_PERMUTATIONS; row 0 is the actual one."""
    size = first + second
    if comb(size, first) <= MAX_PERMUTATIONS:
        chosen = np.array(list(combinations(range(size), first)))
    else:
        rng = np.random.default_rng(_SEED)
        chosen = np.array([np.arange(first), *(rng.permutation(size)[:first] for _ in range(MAX_PERMUTATIONS - 1))])
    taken = np.zeros((len(chosen), size), dtype=bool)
    np.put_along_axis(taken, chosen, True, axis=1)
    return taken


def sign_p(differences: np.ndarray) -> float:
    """Two-sided p of no difference between pairs, by a sign-flip test (Fisher 1935) on (pairs,) differences."""
    finite = differences[np.isfinite(differences)]
    count = len(finite)
    if not count:
        return 1.0
    if 2**count <= MAX_PERMUTATIONS:
        signs = 1 - 2 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)
    else:
        signs = np.random.default_rng(_SEED).choice([-1, 1], (MAX_PERMUTATIONS, count))
        signs[0] = 1
    threshold = abs(finite.sum()) * (1.0 - 1e-9) - 1e-12  # sums round differently
    return float(np.mean(np.abs(signs @ finite) >= threshold))


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P-values corrected by Holm's step-down procedure, by the same keys."""
    corrected, largest = {}, 0.0
    for rank, key in enumerate(sorted(p_values, key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[key]))
        corrected[key] = largest
    return {key: corrected[key] for key in p_values}
