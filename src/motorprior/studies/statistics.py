"""Interquartile means, intervals and permutation tests for few policies, after Agarwal et al., NeurIPS 2021.

Scores are (seeds, draws): a row per trained policy, a column per draw of motors; NaN if undefined. Intervals resample
policies and draws, the same draws for all rows. (The published bootstrap resamples policies within each task, which
treats the walks of one policy as independent; its intervals are too narrow.) p-values are exact permutation tests over
policies: bootstrap tails of eight policies are too light, 25 times at p = 0.0002.
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
LEVEL, SURE = 0.95, 0.05
"""Level of intervals; p below which a difference is significant."""
WAYS = 20_000
"""Most permutations that a test enumerates; of more it samples so many."""
_SEED = 0x57A7
_CHUNK = 1000
"""Resamples in memory at a time."""
Statistic = Callable[[np.ndarray], np.ndarray]
"""(..., scores) -> (...), what is known of them; NaN where nothing is."""
Key = TypeVar("Key", bound=Hashable)
Sampled = Callable[[np.random.Generator, int], np.ndarray]
"""(generator, count) -> (count,) values of a statistic, one for every resample."""


@dataclass(frozen=True)
class Estimate:
    """Attributes: value of a statistic; low and high ends of its 95 % interval, NaN where they are not known."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """One condition against another at the same place.

    Attributes:
        difference: of the statistic, one less the other.
        p: two-sided, see `permutation_p` and, of pairs, `sign_p`.
    """

    difference: Estimate
    p: float

    def is_significant(self, p: float) -> bool:
        """By a corrected p, and 0 is outside of the interval."""
        return p < SURE and (self.difference.low > 0.0 or self.difference.high < 0.0)


def iqm(scores: np.ndarray) -> float:
    """Interquartile mean of all scores [their unit], see `iqms`."""
    return float(iqms(scores.ravel()))


def iqms(scores: np.ndarray) -> np.ndarray:
    """(...) interquartile means of (..., scores) [their unit]: of n known ones without the n/4 lowest and n/4 highest.

    n/4 is rounded down, as in `scipy.stats.trim_mean`.
    """
    ordered = np.sort(scores, axis=-1)  # NaN last
    known = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    place = np.arange(scores.shape[-1])
    middle = (place >= known // 4) & (place < known - known // 4)
    return _mean_of(ordered, middle)


def means(scores: np.ndarray) -> np.ndarray:
    """(...) means of the known of (..., scores)."""
    return _mean_of(scores, np.isfinite(scores))


def estimate(scores: np.ndarray, statistic: Statistic = iqms, resamples: int = RESAMPLES) -> Estimate:
    """A statistic of (seeds, draws) scores with its interval.

    Raises:
        ValueError: no scores.
    """
    _require_scores(scores)

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        return statistic(_taken(scores, _places(rng, count, len(scores)), _places(rng, count, scores.shape[1])))

    return _with_interval(statistic(scores.ravel()), _bootstrap(sampled, resamples))


def compare_scores(
    one: np.ndarray, other: np.ndarray, shared: bool = True, statistic: Statistic = iqms, resamples: int = RESAMPLES
) -> Comparison:
    """Compare (seeds, draws) scores of two conditions at a place.

    Args:
        one: of the first condition.
        other: of the second.
        shared: they walked the same draws, which are then resampled together; their seeds never are.
        statistic: whose difference is told. The test is of the statistic of every policy's own draws.
        resamples: of the bootstrap.

    Raises:
        ValueError: no scores, or shared draws, but another number of them.
    """
    _require_scores(one, other)
    if shared and one.shape[1] != other.shape[1]:
        raise ValueError(f"{one.shape[1]} draws against {other.shape[1]}")

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        columns = _places(rng, count, one.shape[1])
        others = columns if shared else _places(rng, count, other.shape[1])
        mine, theirs = (_places(rng, count, len(each)) for each in (one, other))
        return statistic(_taken(one, mine, columns)) - statistic(_taken(other, theirs, others))

    value = statistic(one.ravel()) - statistic(other.ravel())
    difference = _with_interval(value, _bootstrap(sampled, resamples))
    return Comparison(difference, permutation_p(statistic(one), statistic(other)))


def compare_on_robots(adapted: np.ndarray, others: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare policies that walk one robot each with policies that walk all of these robots.

    The interval resamples robots, the same ones of both, and the other policies. For the test, what the others do on a
    robot less what they do on all, the robot's luck, is taken off the score of its policy. That is known from one walk
    of every other policy, so that p is approximate; where adapted policies always stand and others fall on some robots,
    it is too large.

    Args:
        adapted: (robots, draws) scores of the policy of every robot.
        others: (policies, robots) scores, in the same order of robots.
        statistic: whose difference is told.

    Raises:
        ValueError: no scores, or another number of robots.
    """
    _require_scores(adapted, others)
    if len(adapted) != others.shape[1]:
        raise ValueError(f"{len(adapted)} robots against {others.shape[1]}")

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        robots, policies = _places(rng, count, len(adapted)), _places(rng, count, len(others))
        mine = _taken(adapted, robots, _places(rng, count, adapted.shape[1]))
        return statistic(mine) - statistic(_taken(others, policies, robots))

    value = statistic(adapted.ravel()) - statistic(others.ravel())
    luck = statistic(others.T) - statistic(others.ravel())
    p = permutation_p(statistic(adapted) - luck, statistic(others))
    difference = _with_interval(value, _bootstrap(sampled, RESAMPLES))
    return Comparison(difference, p)


def compare_pairs(one: np.ndarray, other: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare policies of two conditions that walk the same robot each.

    The interval resamples robots and draws, the same ones of both. The test changes the signs of the robots'
    differences in all ways: of eight robots p is 2 / 256 at least.

    Args:
        one: (robots, draws) scores of the policy of every robot.
        other: likewise, of the same robots and draws.
        statistic: whose difference is told.

    Raises:
        ValueError: no scores, or other numbers of robots or draws.
    """
    _require_scores(one, other)
    if one.shape != other.shape:
        raise ValueError(f"{one.shape} robots and draws against {other.shape}")

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        robots, draws = _places(rng, count, len(one)), _places(rng, count, one.shape[1])
        return statistic(_taken(one, robots, draws)) - statistic(_taken(other, robots, draws))

    difference = _with_interval(statistic(one.ravel()) - statistic(other.ravel()), _bootstrap(sampled, RESAMPLES))
    return Comparison(difference, sign_p(statistic(one) - statistic(other)))


def _mean_of(scores: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(...) means of the chosen of (..., scores); NaN where none is."""
    count = chosen.sum(axis=-1)
    return np.where(chosen, scores, 0.0).sum(axis=-1) / np.where(count > 0, count, np.nan)


def _require_scores(*scores: np.ndarray) -> None:
    if not all(each.size for each in scores):
        raise ValueError("no scores")


def _places(rng: np.random.Generator, count: int, size: int) -> np.ndarray:
    return rng.integers(size, size=(count, size))


def _taken(scores: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(count, seeds · draws) of the rows and columns of every resample."""
    return scores[rows[:, :, None], columns[:, None, :]].reshape(len(rows), -1)


def _bootstrap(sampled: Sampled, resamples: int) -> np.ndarray:
    """The values of all resamples, NaN where one is not known."""
    rng = np.random.default_rng(_SEED)
    counts = [min(_CHUNK, resamples - start) for start in range(0, resamples, _CHUNK)]
    return np.concatenate([sampled(rng, count) for count in counts])


def _with_interval(value: float | np.ndarray, found: np.ndarray) -> Estimate:
    """No ends where the value is not known, or where so many resamples are not that an end may lie among them."""
    side, known = 0.5 * (1.0 - LEVEL), found[np.isfinite(found)]
    if not np.isfinite(value) or len(found) - len(known) > side * len(found):
        return Estimate(float(value), float("nan"), float("nan"))
    low, high = np.quantile(known, [side, 1.0 - side])
    return Estimate(float(value), float(low), float(high))


def permutation_p(one: np.ndarray, other: np.ndarray) -> float:
    """Two-sided p of no difference between two conditions, by dealing their policies anew (Pitman 1937).

    The share of all ways to deal the policies to the conditions in which the means differ by at least as much as they
    do. Exact, however few policies there are and whatever their distribution: of eight against eight it is 2 / 12870 at
    least, of two against two 1 / 3. 1 where a condition has no score.

    Args:
        one: (policies,) a score of every policy of the first condition; NaN where it is not known.
        other: likewise of the second.
    """
    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    if not len(one) or not len(other):
        return 1.0
    scores, taken = np.concatenate([one, other]), _splits(len(one), len(other))
    differences = (taken @ scores) / len(one) - (~taken @ scores) / len(other)
    least = abs(one.mean() - other.mean()) * (1.0 - 1e-9) - 1e-12  # sums round differently
    return float(np.mean(np.abs(differences) >= least))


@lru_cache
def _splits(first: int, second: int) -> np.ndarray:
    """(ways, first + second) which scores a way gives to the first condition; row 0 is how they are.

    All ways, or WAYS of them.
    """
    size = first + second
    if comb(size, first) <= WAYS:
        chosen = np.array(list(combinations(range(size), first)))
    else:
        rng = np.random.default_rng(_SEED)
        chosen = np.array([np.arange(first), *(rng.permutation(size)[:first] for _ in range(WAYS - 1))])
    taken = np.zeros((len(chosen), size), dtype=bool)
    np.put_along_axis(taken, chosen, True, axis=1)
    return taken


def sign_p(differences: np.ndarray) -> float:
    """Two-sided p of no difference between pairs, by changing signs in all ways, or in WAYS of them (Fisher 1935).

    Args:
        differences: (pairs,) of scores; NaN where one is not known.
    """
    known = differences[np.isfinite(differences)]
    count = len(known)
    if not count:
        return 1.0
    if 2**count <= WAYS:
        signs = 1 - 2 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)
    else:
        signs = np.random.default_rng(_SEED).choice([-1, 1], (WAYS, count))
        signs[0] = 1
    least = abs(known.sum()) * (1.0 - 1e-9) - 1e-12  # sums round differently
    return float(np.mean(np.abs(signs @ known) >= least))


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P values corrected for their number by the step-down procedure of Holm, by the same keys."""
    corrected, largest = {}, 0.0
    for rank, key in enumerate(sorted(p_values, key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[key]))
        corrected[key] = largest
    return {key: corrected[key] for key in p_values}
