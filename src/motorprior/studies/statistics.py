"""The table of the walks of a study, and its statistics for few policies per bench.

A walk is a row with the seed of its bench, its environment, training condition, training seed,
number ("walk"), and metrics by name, see `gait_quality.walk_metrics`. In one environment, walk k
of every policy of a bench has the same floor, pushes and sensor noise. It also has the same motors,
except for policies that were adapted to a robot: all their walks are on the motors of this robot.

Scores are (benches, policies, walks), NaN if undefined. Benches are random effects: the interval of
a mean over benches includes the variation between benches, policies and walks. With a single bench,
the interval is about the mean over walks; it excludes the variation between trainings.
"""

import csv
import io
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy.special import stdtrit

from motorprior.artifacts import write_text
from motorprior.results import Result, Results
from motorprior.studies.environments import ENVIRONMENTS
from motorprior.studies.gait_quality import UNITS

SAMPLED_PRIOR = "sampled_prior"  # training condition with which the others are compared
COMPARED = ("speed", "upright")  # metrics that are compared
# environments in tables: the training simulations with in-family and out-of-family motors
IN_TRAINING = "own"
IN_TRAINING_OUT_OF_FAMILY = "own_out_of_family"
ALL_ENVIRONMENTS = (IN_TRAINING, IN_TRAINING_OUT_OF_FAMILY, *ENVIRONMENTS)
CONVERGED = 0.95  # smallest mean time upright of a policy that walks in its own simulation [-]

LEVEL = 0.95  # confidence level of intervals
PERMUTATIONS = 20_000  # random assignments of a test
_SEED = 0x57A7

_KEYS = {"bench": int, "environment": str, "condition": str, "seed": int, "walk": int}
WalkRow: TypeAlias = dict[str, Any]  # _KEYS and metrics, NaN if undefined
ConditionKey: TypeAlias = tuple[str, str]  # environment, training condition
MetricKey: TypeAlias = tuple[str, str, str]  # environment, training condition, metric
Key = TypeVar("Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """Value of a statistic, and its interval, NaN if undefined."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Comparison:
    """A training condition compared with a second one in the same environment."""

    difference: Estimate  # first condition's statistic minus the second's
    p: float  # two-sided p of the permutation test, see `permutation_p`


# The table of walks.


def write_walks(path: Path, walks: Sequence[WalkRow]) -> None:
    """Write a CSV file, one row per walk; undefined metrics are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(walks[0])
    for walk in walks:
        cells = [walk[key] for key in _KEYS]
        for name in _metrics_of(walk):
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


def _metrics_of(walk: WalkRow) -> list[str]:
    return [name for name in walk if name not in _KEYS]


def scores(walks: Sequence[WalkRow], metric: str) -> np.ndarray:
    """(benches, seeds, walks) values of one metric, for walks of one condition in one environment.

    Benches, seeds and walks are in ascending order.
    """
    ordered = sorted(walks, key=lambda walk: (walk["bench"], walk["seed"], walk["walk"]))
    benches = {walk["bench"] for walk in walks}
    seeds = {walk["seed"] for walk in walks}
    values = np.array([walk[metric] for walk in ordered])
    return values.reshape(len(benches), len(seeds), -1)


# Statistics of scores.


def means(scores: np.ndarray) -> np.ndarray:
    """(...) means of the finite values among (..., scores); NaN if there are none."""
    is_finite = np.isfinite(scores)
    count = is_finite.sum(axis=-1)
    total = np.where(is_finite, scores, 0.0).sum(axis=-1)
    return total / np.where(count > 0, count, np.nan)


def estimate(scores: np.ndarray) -> Estimate:
    """Mean over benches of the mean of all walks of a bench, with its interval.

    With a single bench: mean over the walk numbers of the mean of all policies' walks with this
    number.
    """
    return mean_interval(_independent_values(scores))


def compare_scores(first: np.ndarray, second: np.ndarray) -> Comparison:
    """Compare the scores of two training conditions in one environment, on the same benches."""
    differences = _independent_values(first) - _independent_values(second)
    p = permutation_p(means(first), means(second)) if len(first) > 1 else float("nan")
    return Comparison(mean_interval(differences), p)


def _independent_values(scores: np.ndarray) -> np.ndarray:
    """(benches,) mean of each bench; for a single bench, (walks,) means of each walk number.

    An interval is computed from the variation between these values.
    """
    if len(scores) > 1:
        return means(scores.reshape(len(scores), -1))
    return means(scores[0].T)  # over the policies


def mean_interval(values: np.ndarray, level: float = LEVEL) -> Estimate:
    """Mean ± t·s/√n of the n finite values (Student 1908), t with n - 1 degrees of freedom.

    ``level`` is the confidence level.
    """
    values = values[np.isfinite(values)]
    count = len(values)
    if count < 2:
        value = float(values[0]) if count else float("nan")
        return Estimate(value, float("nan"), float("nan"))

    mean = float(values.mean())
    error = float(values.std(ddof=1)) / np.sqrt(count)
    reach = float(stdtrit(count - 1, 0.5 * (1.0 + level))) * error
    return Estimate(mean, mean - reach, mean + reach)


def permutation_p(first: np.ndarray, second: np.ndarray) -> float:
    """Two-sided permutation p of no difference between two training conditions (Pitman 1937).

    Arguments are scores (benches, policies) without NaN. A random assignment assigns the scores of
    each bench to the two conditions. p is the share of assignments, the actual one included, whose
    |mean difference over benches| is at least the actual one: p is at least 1 / 20 001, and 1 for a
    single policy per condition. p is about these benches, while the interval of the difference
    includes the variation between benches.
    """
    all_scores = np.concatenate([first, second], axis=1)
    num_policies = all_scores.shape[1]
    if num_policies < 3:
        return 1.0

    rng = np.random.default_rng(_SEED)
    unshuffled = np.broadcast_to(np.arange(num_policies), (PERMUTATIONS, *all_scores.shape))
    order = rng.permuted(unshuffled, axis=-1)  # (permutations, benches, policies) indices
    actual = all_scores[None]
    shuffled = np.take_along_axis(actual, order, axis=-1)
    assignments = np.concatenate([actual, shuffled])

    is_first = np.arange(num_policies) < first.shape[1]
    means_of_first = means(assignments[..., is_first])
    means_of_second = means(assignments[..., ~is_first])
    differences = np.abs(means(means_of_first - means_of_second))
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
    """Statistics of a table of walks, by (environment, condition, metric)."""

    benches: tuple[int, ...]  # seeds of the benches
    estimates: dict[MetricKey, Estimate]  # mean over benches, with its 95 % interval
    by_bench: dict[MetricKey, np.ndarray]  # (benches,) means of the COMPARED metrics
    upright: dict[ConditionKey, np.ndarray]  # (benches, policies) mean time upright
    # comparison of a condition with the sampled prior; p is corrected for all these comparisons,
    # and NaN for a single bench
    differences: dict[MetricKey, Comparison]

    def as_results(self) -> Results:
        """The statistics as rows.

        ENVIRONMENT/CONDITION/METRIC, with /low and /high, is an estimate. Names of the statistics
        of one bench begin with bench_SEED/. ENVIRONMENT/CONDITION/policies_upright is the share of
        policies that are upright for at least CONVERGED of the time.
        ENVIRONMENT/CONDITION/METRIC_p_against_sampled_prior is the p of a comparison; a single
        bench has none.
        """
        rows = []
        for (env, condition, metric), interval in self.estimates.items():
            name = f"{env}/{condition}/{metric}"
            unit = UNITS[metric.partition("/")[0]]
            ends = {None: interval.value, "low": interval.low, "high": interval.high}
            for end, value in ends.items():
                if np.isfinite(value):
                    rows.append(Result(name, unit, value, statistic=end))

        for (env, condition, metric), values in self.by_bench.items():
            for bench, value in zip(self.benches, values, strict=True):
                name = f"bench_{bench}/{env}/{condition}/{metric}"
                rows.append(Result(name, UNITS[metric], float(value)))

        for (env, condition), policies in self.upright.items():
            share = float(np.mean(policies >= CONVERGED))
            rows.append(Result(f"{env}/{condition}/policies_upright", "1", share))

        for (env, condition, metric), comparison in self.differences.items():
            name = f"{env}/{condition}/{metric}_p_against_{SAMPLED_PRIOR}"
            if np.isfinite(comparison.p):
                rows.append(Result(name, "1", comparison.p))
        return Results(rows)


def summarise(walks: Sequence[WalkRow]) -> StudyStatistics:
    """Statistics of all walks."""
    cells = _cells(walks)
    estimates: dict[MetricKey, Estimate] = {}
    by_bench: dict[MetricKey, np.ndarray] = {}
    upright: dict[ConditionKey, np.ndarray] = {}
    differences: dict[MetricKey, Comparison] = {}
    for (env, condition), cell in cells.items():
        for metric in _metrics_of(cell[0]):
            if any(np.isfinite(walk[metric]) for walk in cell):
                estimates[env, condition, metric] = _estimate_of(cell, metric)

        for metric in COMPARED:
            values = scores(cell, metric)
            by_bench[env, condition, metric] = means(values.reshape(len(values), -1))
        upright[env, condition] = means(scores(cell, "upright"))

        walks_of_prior = cells.get((env, SAMPLED_PRIOR))
        if env in ENVIRONMENTS and condition != SAMPLED_PRIOR and walks_of_prior is not None:
            for metric in COMPARED:
                differences[env, condition, metric] = compare_scores(
                    scores(cell, metric), scores(walks_of_prior, metric)
                )

    benches = tuple(sorted({walk["bench"] for walk in walks}))
    return StudyStatistics(benches, estimates, by_bench, upright, _corrected(differences))


def _cells(walks: Iterable[WalkRow]) -> dict[ConditionKey, list[WalkRow]]:
    """Walks by environment and condition; the conditions of an environment follow each other."""
    cells: dict[ConditionKey, list[WalkRow]] = {}
    for walk in walks:
        cells.setdefault((walk["environment"], walk["condition"]), []).append(walk)
    environments = [env for env, _ in cells]
    order = sorted(cells, key=lambda cell: environments.index(cell[0]))
    return {cell: cells[cell] for cell in order}


def _estimate_of(walks: Sequence[WalkRow], metric: str) -> Estimate:
    result = estimate(scores(walks, metric))
    if metric == "upright":  # a share
        return replace(result, low=max(0.0, result.low), high=min(1.0, result.high))
    return result


def _corrected(differences: Mapping[MetricKey, Comparison]) -> dict[MetricKey, Comparison]:
    """The comparisons, with p corrected for the number of comparisons."""
    p_values = {}
    for key, comparison in differences.items():
        if np.isfinite(comparison.p):
            p_values[key] = comparison.p
    corrected = holm(p_values)
    return {
        key: replace(comparison, p=corrected.get(key, float("nan")))
        for key, comparison in differences.items()
    }
