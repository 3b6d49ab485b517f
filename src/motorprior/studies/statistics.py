"""The table of the walks of a study, and its statistics for few policies per bench.

A walk is a row with the seed of its bench, its environment, training condition, training seed,
number ("walk"), and measures by name, see `gait_quality.walk_measures`. In one environment, walk k
of every policy of a bench has the same conditions and, but for policies that were adapted to a
robot, the same motors.

Scores are (benches, policies, walks), NaN if undefined. Benches are random effects: an interval is
that of the mean over benches, so it includes the variation between benches, policies and walks.
With a single bench it is over walks and excludes the variation between trainings.
"""

import csv
import io
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from scipy.special import stdtrit

from motorprior.artifacts import write_text
from motorprior.results import Result, Results
from motorprior.studies.environments import ENVIRONMENTS
from motorprior.studies.gait_quality import UNITS

REFERENCE = "sampled_prior"
COMPARED = ("speed", "upright")
# training simulations; the second with out-of-family motors
OWN = "own"
OWN_OUT_OF_FAMILY = "own_out_of_family"
ALL_ENVIRONMENTS = (OWN, OWN_OUT_OF_FAMILY, *ENVIRONMENTS)
CONVERGED = 0.9  # smallest mean time upright of a policy that walks in its own simulation [-]
_KEYS = {"bench": int, "environment": str, "condition": str, "seed": int, "walk": int}

WalkRow: TypeAlias = dict[str, Any]  # _KEYS and measures, NaN if undefined

LEVEL = 0.95  # confidence level of intervals
PERMUTATIONS = 20_000  # random assignments of a test
_SEED = 0x57A7
# (..., scores) -> (...) of the finite scores; NaN if there are none
Statistic = Callable[[np.ndarray], np.ndarray]
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
        return Estimate(
            float(values[0]) if len(values) else float("nan"), float("nan"), float("nan")
        )
    mean = float(values.mean())
    error = float(values.std(ddof=1)) / np.sqrt(len(values))
    reach = float(stdtrit(len(values) - 1, 0.5 * (1.0 + LEVEL))) * error
    return Estimate(mean, mean - reach, mean + reach)


def permutation_p(one: np.ndarray, other: np.ndarray) -> float:
    """Two-sided permutation p of no difference between the (benches, policies) scores of two conditions (Pitman 1937).

    Share of random assignments of the scores of each bench to the conditions, the actual one
    included, whose mean difference over benches is at least as large, without NaN: at least 1 / 20
    001; 1 for a single policy. It holds for these benches; the interval of the difference includes
    the variation between benches.
    """
    both = np.concatenate([one, other], axis=1)
    if both.shape[1] < 3:
        return 1.0
    first = np.arange(both.shape[1]) < one.shape[1]
    rng = np.random.default_rng(_SEED)
    order = rng.permuted(
        np.broadcast_to(np.arange(both.shape[1]), (PERMUTATIONS, *both.shape)), axis=-1
    )
    shuffled = np.concatenate([both[None], np.take_along_axis(both[None], order, axis=-1)])
    found = np.abs(means(means(shuffled[..., first]) - means(shuffled[..., ~first])))
    return float(np.mean(found >= found[0] - 1e-12))


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P-values corrected by Holm's step-down procedure, by the same keys."""
    ordered = sorted(p_values, key=p_values.__getitem__)
    steps = [min(1.0, (len(ordered) - rank) * p_values[key]) for rank, key in enumerate(ordered)]
    corrected = (
        dict(zip(ordered, np.maximum.accumulate(steps).tolist(), strict=True)) if ordered else {}
    )
    return {key: corrected[key] for key in p_values}


@dataclass(frozen=True)
class StudyStatistics:
    """Statistics of a table of walks, by (environment, condition, measure)."""

    benches: tuple[int, ...]  # seeds of the benches
    # mean over benches of the interquartile mean, of ``upright`` of the mean, with 95 % interval
    estimates: dict[tuple[str, str, str], Estimate]
    # (benches,) the statistics of the benches, of COMPARED measures
    by_bench: dict[tuple[str, str, str], np.ndarray]
    # (environment, condition) -> (benches, policies) mean time upright
    upright: dict[tuple[str, str], np.ndarray]
    # condition compared with the sampled prior; p is corrected for all of these comparisons
    differences: dict[tuple[str, str, str], Comparison]

    def as_results(self) -> Results:
        """Rows ENVIRONMENT/CONDITION/MEASURE with /low and /high; those of every bench begin with bench_SEED/.

        Also ENVIRONMENT/CONDITION/policies_upright, the share of policies that are upright for
        CONVERGED of the time, and ENVIRONMENT/CONDITION/MEASURE_p_against_sampled_prior.
        """
        rows = []
        for (env, condition, measure), found in self.estimates.items():
            unit = UNITS[measure.partition("/")[0]]
            name = f"{env}/{condition}/{measure}"
            ends = {None: found.value, "low": found.low, "high": found.high}
            rows += [
                Result(name, unit, value, statistic=end)
                for end, value in ends.items()
                if np.isfinite(value)
            ]
        for (env, condition, measure), values in self.by_bench.items():
            names = [f"bench_{bench}/{env}/{condition}/{measure}" for bench in self.benches]
            rows += [
                Result(name, UNITS[measure], float(value))
                for name, value in zip(names, values, strict=True)
            ]
        for (env, condition), policies in self.upright.items():
            rows.append(
                Result(
                    f"{env}/{condition}/policies_upright",
                    "1",
                    float(np.mean(policies >= CONVERGED)),
                )
            )
        for (env, condition, measure), each in self.differences.items():
            rows.append(Result(f"{env}/{condition}/{measure}_p_against_{REFERENCE}", "1", each.p))
        return Results(rows)


def write_walks(path: Path, walks: Sequence[WalkRow]) -> None:
    """Write a CSV file, one row per walk; undefined measures are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(walks[0])
    for walk in walks:
        numbers = (
            "" if np.isnan(walk[name]) else f"{walk[name]:.6g}"
            for name in walk
            if name not in _KEYS
        )
        writer.writerow([*(walk[key] for key in _KEYS), *numbers])
    write_text(path, text.getvalue())


def read_walks(path: Path) -> list[WalkRow]:
    """Read what `write_walks` wrote."""
    with path.open(encoding="utf-8", newline="") as file:
        return [
            {
                name: _KEYS[name](text) if name in _KEYS else float(text or "nan")
                for name, text in row.items()
            }
            for row in csv.DictReader(file)
        ]


def scores(walks: Sequence[WalkRow], measure: str) -> np.ndarray:
    """(benches, seeds, walks) of one measure of one condition in one environment, all sorted."""
    ordered = sorted(walks, key=lambda walk: (walk["bench"], walk["seed"], walk["walk"]))
    shape = (len({walk[key] for walk in walks}) for key in ("bench", "seed"))
    return np.array([walk[measure] for walk in ordered]).reshape(*shape, -1)


def statistic_of(measure: str) -> Statistic:
    """Mean of the time upright (an interquartile mean would hide falls); interquartile mean of other measures."""
    return means if measure == "upright" else iqms


def summarise(walks: Sequence[WalkRow]) -> StudyStatistics:
    """Statistics of all walks."""
    cells: dict[tuple[str, str], list[WalkRow]] = {}
    for walk in walks:
        cells.setdefault((walk["environment"], walk["condition"]), []).append(walk)
    estimates = {}
    by_bench = {}
    upright = {}
    differences = {}
    envs = [env for env, _ in cells]
    for env, condition in sorted(cells, key=lambda cell: envs.index(cell[0])):
        cell = cells[env, condition]
        reference = cells.get((env, REFERENCE))
        for measure in (name for name in cell[0] if name not in _KEYS):
            if any(np.isfinite(walk[measure]) for walk in cell):
                found = estimate(scores(cell, measure), statistic_of(measure))
                if measure == "upright":
                    found = replace(found, low=max(0.0, found.low), high=min(1.0, found.high))
                estimates[env, condition, measure] = found
        for measure in COMPARED:
            of_cell = scores(cell, measure)
            by_bench[env, condition, measure] = statistic_of(measure)(
                of_cell.reshape(len(of_cell), -1)
            )
        upright[env, condition] = means(scores(cell, "upright"))
        if env in ENVIRONMENTS and condition != REFERENCE and reference is not None:
            for measure in COMPARED:
                one = scores(cell, measure)
                other = scores(reference, measure)
                differences[env, condition, measure] = compare_scores(
                    one, other, statistic_of(measure)
                )
    corrected = holm({key: each.p for key, each in differences.items()})
    benches = tuple(sorted({walk["bench"] for walk in walks}))
    differences = {key: replace(each, p=corrected[key]) for key, each in differences.items()}
    return StudyStatistics(benches, estimates, by_bench, upright, differences)
