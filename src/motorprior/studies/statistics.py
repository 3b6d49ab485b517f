"""The table of the walks of a study, and its statistics for few policies per bench.

A walk is a row with the seed of its bench, its environment, training condition, training seed,
number ("walk"), and measures by name, see `gait_quality.walk_measures`. In one environment, walk k
of every policy of a bench has the same floor, pushes and sensor noise and, but for policies that
were adapted to a robot, the same motors.

Scores are (benches, policies, walks), NaN if undefined. Benches are random effects: an interval of
the mean over benches includes the variation between benches, policies and walks. With a single
bench it is over walks and excludes the variation between trainings.
"""

import csv
import io
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy.special import stdtrit

from motorprior.artifacts import write_text
from motorprior.results import Result, Results
from motorprior.studies.environments import ENVIRONMENTS
from motorprior.studies.gait_quality import UNITS

REFERENCE = "sampled_prior"  # training condition with which the others are compared
COMPARED = ("speed", "upright")  # measures that are compared
# training simulations; the second with out-of-family motors
OWN = "own"
OWN_OUT_OF_FAMILY = "own_out_of_family"
ALL_ENVIRONMENTS = (OWN, OWN_OUT_OF_FAMILY, *ENVIRONMENTS)
CONVERGED = 0.9  # smallest mean time upright of a policy that walks in its own simulation [-]

LEVEL = 0.95  # confidence level of intervals
PERMUTATIONS = 20_000  # random assignments of a test
_SEED = 0x57A7

_KEYS = {"bench": int, "environment": str, "condition": str, "seed": int, "walk": int}
WalkRow: TypeAlias = dict[str, Any]  # _KEYS and measures, NaN if undefined
# (..., scores) -> (...) of the finite scores; NaN if there are none
Statistic = Callable[[np.ndarray], np.ndarray]
Cell: TypeAlias = tuple[str, str]  # environment, condition
Measured: TypeAlias = tuple[str, str, str]  # environment, condition, measure
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """Value of a statistic, and its 95 % interval, NaN if undefined."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """A training condition compared with a second one in the same environment."""

    difference: Estimate  # of the statistic, the first minus the second
    p: float  # two-sided, see `permutation_p`


# The table of walks.


def write_walks(path: Path, walks: Sequence[WalkRow]) -> None:
    """Write a CSV file, one row per walk; undefined measures are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(walks[0])
    for walk in walks:
        cells = [walk[key] for key in _KEYS]
        for name in _measures_of(walk):
            value = walk[name]
            cells.append("" if np.isnan(value) else f"{value:.6g}")
        writer.writerow(cells)
    write_text(path, text.getvalue())


def read_walks(path: Path) -> list[WalkRow]:
    """Read what `write_walks` wrote."""
    walks = []
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            walk: WalkRow = {}
            for name, text in row.items():
                walk[name] = _KEYS[name](text) if name in _KEYS else float(text or "nan")
            walks.append(walk)
    return walks


def _measures_of(walk: WalkRow) -> list[str]:
    return [name for name in walk if name not in _KEYS]


def scores(walks: Sequence[WalkRow], measure: str) -> np.ndarray:
    """(benches, seeds, walks) of one measure of one condition in one environment, all sorted."""
    ordered = sorted(walks, key=lambda walk: (walk["bench"], walk["seed"], walk["walk"]))
    benches = {walk["bench"] for walk in walks}
    seeds = {walk["seed"] for walk in walks}
    values = np.array([walk[measure] for walk in ordered])
    return values.reshape(len(benches), len(seeds), -1)


# Statistics of scores.


def iqms(scores: np.ndarray) -> np.ndarray:
    """(...) interquartile means of (..., scores).

    Of n finite scores, the n/4 lowest and the n/4 highest are left out. n/4 is rounded down, as in
    `scipy.stats.trim_mean`.
    """
    ordered = np.sort(scores, axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    rank = np.arange(scores.shape[-1])
    is_middle = (rank >= count // 4) & (rank < count - count // 4)
    return _masked_mean(ordered, is_middle)


def means(scores: np.ndarray) -> np.ndarray:
    """(...) means of the finite of (..., scores)."""
    return _masked_mean(scores, np.isfinite(scores))


def _masked_mean(scores: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(...) means of (..., scores) where the mask is true; NaN if it is nowhere."""
    count = mask.sum(axis=-1)
    total = np.where(mask, scores, 0.0).sum(axis=-1)
    return total / np.where(count > 0, count, np.nan)


def statistic_of(measure: str) -> Statistic:
    """Mean of the time upright; interquartile mean of other measures.

    An interquartile mean of the time upright would hide falls.
    """
    return means if measure == "upright" else iqms


def estimate(scores: np.ndarray, statistic: Statistic = iqms) -> Estimate:
    """Mean over benches of the statistic of a bench's walks, with its interval.

    For a single bench, the mean is over its samples.
    """
    return _interval(_units(scores, statistic))


def compare_scores(one: np.ndarray, two: np.ndarray, statistic: Statistic = iqms) -> Comparison:
    """Compare scores of two training conditions on the same benches and samples."""
    difference = _interval(_units(one, statistic) - _units(two, statistic))
    return Comparison(difference, permutation_p(statistic(one), statistic(two)))


def _units(scores: np.ndarray, statistic: Statistic) -> np.ndarray:
    """A value per bench; for a single bench, a value per sample."""
    if len(scores) > 1:
        return statistic(scores.reshape(len(scores), -1))
    return statistic(scores[0].T)


def _interval(values: np.ndarray) -> Estimate:
    """Mean ± t·s/√n of n values (Student 1908), t with n - 1 degrees of freedom."""
    values = values[np.isfinite(values)]
    count = len(values)
    if count < 2:
        value = float(values[0]) if count else float("nan")
        return Estimate(value, float("nan"), float("nan"))

    mean = float(values.mean())
    error = float(values.std(ddof=1)) / np.sqrt(count)
    reach = float(stdtrit(count - 1, 0.5 * (1.0 + LEVEL))) * error
    return Estimate(mean, mean - reach, mean + reach)


def permutation_p(one: np.ndarray, two: np.ndarray) -> float:
    """Two-sided permutation p of no difference between two training conditions (Pitman 1937).

    Arguments are scores (benches, policies) without NaN. p is the share of random assignments of
    the scores of each bench to the conditions, the actual one included, whose mean difference over
    benches is at least as large: at least 1 / 20 001; 1 for a single policy. It holds for these
    benches; the interval of the difference includes the variation between benches.
    """
    both = np.concatenate([one, two], axis=1)
    num_policies = both.shape[1]
    if num_policies < 3:
        return 1.0

    rng = np.random.default_rng(_SEED)
    policies = np.broadcast_to(np.arange(num_policies), (PERMUTATIONS, *both.shape))
    order = rng.permuted(policies, axis=-1)
    shuffled = np.take_along_axis(both[None], order, axis=-1)
    assignments = np.concatenate([both[None], shuffled])  # the actual one first

    is_one = np.arange(num_policies) < one.shape[1]
    means_of_one = means(assignments[..., is_one])
    means_of_two = means(assignments[..., ~is_one])
    differences = np.abs(means(means_of_one - means_of_two))
    return float(np.mean(differences >= differences[0] - 1e-12))


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P-values corrected by Holm's step-down procedure, by the same keys."""
    ordered = sorted(p_values, key=p_values.__getitem__)
    corrected = {}
    largest = 0.0
    for rank, key in enumerate(ordered):
        step = min(1.0, (len(ordered) - rank) * p_values[key])
        largest = max(largest, step)  # a p-value must not fall below the one before it
        corrected[key] = largest
    return {key: corrected[key] for key in p_values}


# The summary of a study.


@dataclass(frozen=True)
class StudyStatistics:
    """Statistics of a table of walks, by (environment, condition, measure)."""

    benches: tuple[int, ...]  # seeds of the benches
    # mean over benches of the interquartile mean, of ``upright`` of the mean, with 95 % interval
    estimates: dict[Measured, Estimate]
    by_bench: dict[Measured, np.ndarray]  # (benches,) the statistics of COMPARED measures
    upright: dict[Cell, np.ndarray]  # (benches, policies) mean time upright
    # condition compared with the sampled prior; p is corrected for all of these comparisons
    differences: dict[Measured, Comparison]

    def as_results(self) -> Results:
        """Rows ENVIRONMENT/CONDITION/MEASURE with /low and /high.

        Rows of every bench begin with bench_SEED/. There are also
        ENVIRONMENT/CONDITION/policies_upright, the share of policies that are upright for CONVERGED
        of the time, and ENVIRONMENT/CONDITION/MEASURE_p_against_sampled_prior.
        """
        rows = []
        for (env, condition, measure), interval in self.estimates.items():
            name = f"{env}/{condition}/{measure}"
            unit = UNITS[measure.partition("/")[0]]
            ends = {None: interval.value, "low": interval.low, "high": interval.high}
            for end, value in ends.items():
                if np.isfinite(value):
                    rows.append(Result(name, unit, value, statistic=end))

        for (env, condition, measure), values in self.by_bench.items():
            for bench, value in zip(self.benches, values, strict=True):
                name = f"bench_{bench}/{env}/{condition}/{measure}"
                rows.append(Result(name, UNITS[measure], float(value)))

        for (env, condition), policies in self.upright.items():
            share = float(np.mean(policies >= CONVERGED))
            rows.append(Result(f"{env}/{condition}/policies_upright", "1", share))

        for (env, condition, measure), comparison in self.differences.items():
            name = f"{env}/{condition}/{measure}_p_against_{REFERENCE}"
            rows.append(Result(name, "1", comparison.p))
        return Results(rows)


def summarise(walks: Sequence[WalkRow]) -> StudyStatistics:
    """Statistics of all walks."""
    cells = _cells(walks)
    estimates: dict[Measured, Estimate] = {}
    by_bench: dict[Measured, np.ndarray] = {}
    upright: dict[Cell, np.ndarray] = {}
    differences: dict[Measured, Comparison] = {}
    for (env, condition), cell in cells.items():
        for measure in _measures_of(cell[0]):
            if any(np.isfinite(walk[measure]) for walk in cell):
                estimates[env, condition, measure] = _estimate_of(cell, measure)

        for measure in COMPARED:
            of_cell = scores(cell, measure)
            statistic = statistic_of(measure)
            by_bench[env, condition, measure] = statistic(of_cell.reshape(len(of_cell), -1))
        upright[env, condition] = means(scores(cell, "upright"))

        reference = cells.get((env, REFERENCE))
        if env in ENVIRONMENTS and condition != REFERENCE and reference is not None:
            for measure in COMPARED:
                differences[env, condition, measure] = compare_scores(
                    scores(cell, measure), scores(reference, measure), statistic_of(measure)
                )

    benches = tuple(sorted({walk["bench"] for walk in walks}))
    return StudyStatistics(benches, estimates, by_bench, upright, _corrected(differences))


def _cells(walks: Iterable[WalkRow]) -> dict[Cell, list[WalkRow]]:
    """Walks by environment and condition, all conditions of an environment in turn."""
    cells: dict[Cell, list[WalkRow]] = {}
    for walk in walks:
        cells.setdefault((walk["environment"], walk["condition"]), []).append(walk)
    environments = [env for env, _ in cells]
    order = sorted(cells, key=lambda cell: environments.index(cell[0]))
    return {cell: cells[cell] for cell in order}


def _estimate_of(walks: Sequence[WalkRow], measure: str) -> Estimate:
    result = estimate(scores(walks, measure), statistic_of(measure))
    if measure == "upright":  # a share
        return replace(result, low=max(0.0, result.low), high=min(1.0, result.high))
    return result


def _corrected(differences: Mapping[Measured, Comparison]) -> dict[Measured, Comparison]:
    """The comparisons with p corrected for all of them."""
    p_values = holm({key: comparison.p for key, comparison in differences.items()})
    return {key: replace(comparison, p=p_values[key]) for key, comparison in differences.items()}
