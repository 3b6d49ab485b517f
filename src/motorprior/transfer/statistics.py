"""How sure a comparison of policies is: interquartile means, intervals, tests, after Agarwal et al., NeurIPS 2021.

Scores are (seeds, draws): a row per trained policy, a column per draw of motors; NaN where one cannot be told. An
interval resamples both: policies with replacement, and draws with replacement, the same ones for all rows. The
published bootstrap resamples policies within every task alone, which takes the policies of a seed at two draws for
independent and gives narrower intervals than there are.

No p value comes from a bootstrap: of eight policies its tails are too light, twenty-five times at p = 0.0002, and a
correction for many comparisons lives in the tails. Tests permute policies, see `permutation_tests`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motorprior.transfer.permutation_tests import permutation_p, sign_p

RESAMPLES = 2000
LEVEL, SURE = 0.95, 0.05
"""Of intervals; p value below which a difference is no accident."""
_SEED = 0x57A7
_CHUNK = 1000
"""Resamples in memory at a time."""
Statistic = Callable[[np.ndarray], np.ndarray]
"""(..., scores) -> (...), what is known of them; NaN where nothing is."""
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
        improvement: see `improvement`.
        p: two-sided, see `permutation_p` and, of pairs, `sign_p`.
    """

    difference: Estimate
    improvement: float
    p: float

    def is_sure(self, p: float) -> bool:
        """Whether there is a difference beyond doubt: by a corrected p, and the interval is known and without 0."""
        return p < SURE and (self.difference.low > 0.0 or self.difference.high < 0.0)

    def turned(self) -> Comparison:
        """The other against the one."""
        there = self.difference
        return Comparison(Estimate(-there.value, -there.high, -there.low), 1.0 - self.improvement, self.p)


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
    return Comparison(difference, improvement(one, other, shared), permutation_p(statistic(one), statistic(other)))


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
    return Comparison(difference, _share_better(adapted[:, :, None] - others.T[:, None, :]), p)


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
    return Comparison(difference, _share_better(one - other), sign_p(statistic(one) - statistic(other)))


def ratio(there: np.ndarray, own: np.ndarray, least: float, resamples: int = RESAMPLES) -> Estimate:
    """Interquartile mean at a place over that at another [-]; policies stay together, the places' draws do not.

    Args:
        there: (seeds, draws) of the policies at a place.
        own: (seeds, other draws) of the same policies, in the same order, at the other.
        least: interquartile mean below which nothing is measured in its shares; the ratio is then NaN.
        resamples: of the bootstrap.

    Raises:
        ValueError: no scores, or of another number of policies.
    """
    _require_scores(there, own)
    if len(there) != len(own):
        raise ValueError(f"{len(there)} policies against {len(own)}")

    def quotient(above: np.ndarray, below: np.ndarray) -> np.ndarray:
        return above / np.where(below >= least, below, np.nan)

    def sampled(rng: np.random.Generator, count: int) -> np.ndarray:
        rows = _places(rng, count, len(there))
        here, home = (_taken(each, rows, _places(rng, count, each.shape[1])) for each in (there, own))
        return quotient(iqms(here), iqms(home))

    return _with_interval(quotient(iqms(there.ravel()), iqms(own.ravel())), _bootstrap(sampled, resamples))


def improvement(one: np.ndarray, other: np.ndarray, shared: bool = True) -> float:
    """Probability of improvement [-]: mean over pairs of policies and shared draws of [better] + ½ [equal].

    Without shared draws every walk of the one meets every walk of the other. Pairs of which one is not known are left
    out; NaN where none is left.
    """
    return _share_better(
        one[:, None, :] - other[None, :, :] if shared else np.subtract.outer(one.ravel(), other.ravel())
    )


def _share_better(gain: np.ndarray) -> float:
    """Share of the known gains that are above 0, and half of those that are 0."""
    known = gain[np.isfinite(gain)]
    return float(np.mean((known > 0.0) + 0.5 * (known == 0.0))) if len(known) else float("nan")


def profile(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """(thresholds,) share of the walks whose score is above each threshold [-]; an unknown one is above none."""
    return np.mean(scores.ravel()[:, None] > thresholds[None, :], axis=0)


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
