"""Table of the walks of a transfer study, and its statistics: estimates with intervals, differences from the prior.

A walk is a row with its environment ("place"), training condition, training seed, draw, and measures by name, see
`gait_quality.walk_measures`. The draw is the number of the sample of motors and conditions, the same for every policy
in an environment.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from motorprior.artifacts import write_text
from motorprior.results import Result, Results
from motorprior.studies import statistics
from motorprior.studies.environments import ENVIRONMENTS
from motorprior.studies.gait_quality import UNITS

CONDITIONS = (  # of training, in the order of every table, see docs/transfer.md
    "untrained", "ideal_pd", "tuned_pd", "pd_friction", "pd_randomised", "pd_adapted", "one_network", "paper",
    "paper_wide", "prior_mean", "prior", "prior_adapted", "prior_robust", "oracle",
)  # fmt: skip
ADAPTED = ("prior_adapted", "pd_adapted")  # the policy of seed k is fitted to robot k, and walks on it alone
REFERENCE = "prior"
COMPARED = ("speed", "upright")
OWN, OWN_FOREIGN = "own", "own_foreign"  # training simulations, the second of policies for out-of-family motors
PLACES = (OWN, OWN_FOREIGN, *ENVIRONMENTS)
_KEYS = {"place": str, "condition": str, "seed": int, "draw": int}

WalkRow: TypeAlias = dict[str, Any]  # _KEYS and measures, NaN if undefined


@dataclass(frozen=True)
class Summary:
    """Statistics of a table of walks.

    Attributes:
        estimates: (environment, condition, measure) -> interquartile mean, of ``upright`` the mean, with 95 % interval.
        upright: (environment, condition) -> share of the policies that are upright for at least 90 % of the time.
        differences: (environment, condition, measure) -> condition compared with the sampled prior; p is corrected for
            all of these comparisons.
    """

    estimates: dict[tuple[str, str, str], statistics.Estimate]
    upright: dict[tuple[str, str], float]
    differences: dict[tuple[str, str, str], statistics.Comparison]

    def as_results(self) -> Results:
        """Rows PLACE/CONDITION/MEASURE with /low and /high, /policies_upright, MEASURE_p_against_prior."""
        rows = []
        for (place, condition, measure), found in self.estimates.items():
            unit, name = UNITS[measure.partition("/")[0]], f"{place}/{condition}/{measure}"
            ends = {None: found.value, "low": found.low, "high": found.high}
            rows += [Result(name, unit, value, statistic=end) for end, value in ends.items() if np.isfinite(value)]
        for (place, condition), share in self.upright.items():
            rows.append(Result(f"{place}/{condition}/policies_upright", "1", share))
        for (place, condition, measure), each in self.differences.items():
            rows.append(Result(f"{place}/{condition}/{measure}_p_against_{REFERENCE}", "1", each.p))
        return Results.of(rows)


def write_walks(path: Path, walks: Sequence[WalkRow]) -> None:
    """Write a CSV file, one row per walk; undefined measures are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(walks[0])
    for walk in walks:
        numbers = ("" if np.isnan(walk[name]) else f"{walk[name]:.6g}" for name in walk if name not in _KEYS)
        writer.writerow([*(walk[key] for key in _KEYS), *numbers])
    write_text(path, text.getvalue())


def read_walks(path: Path) -> list[WalkRow]:
    """Read what `write_walks` wrote."""
    with path.open(encoding="utf-8", newline="") as file:
        return [
            {name: _KEYS[name](text) if name in _KEYS else float(text or "nan") for name, text in row.items()}
            for row in csv.DictReader(file)
        ]


def scores(walks: Sequence[WalkRow], measure: str) -> np.ndarray:
    """(seeds, draws) of one measure of one condition in one environment, both sorted."""
    ordered = sorted(walks, key=lambda walk: (walk["seed"], walk["draw"]))
    return np.array([walk[measure] for walk in ordered]).reshape(len({walk["seed"] for walk in walks}), -1)


def estimate(walks: Sequence[WalkRow], measure: str) -> statistics.Estimate:
    """Mean of the time upright (an interquartile mean would hide falls); interquartile mean of other measures."""
    return statistics.estimate(scores(walks, measure), _statistic_of(measure))


def _statistic_of(measure: str) -> statistics.Statistic:
    return statistics.means if measure == "upright" else statistics.iqms


def summarise(walks: Sequence[WalkRow]) -> Summary:
    """Statistics of all walks."""
    cells: dict[tuple[str, str], list[WalkRow]] = {}
    for walk in walks:
        cells.setdefault((walk["place"], walk["condition"]), []).append(walk)
    estimates, upright, differences = {}, {}, {}
    places = [place for place, _ in cells]
    for place, condition in sorted(cells, key=lambda cell: places.index(cell[0])):
        cell, reference = cells[place, condition], cells.get((place, REFERENCE))
        for measure in (name for name in cell[0] if name not in _KEYS):
            if any(np.isfinite(walk[measure]) for walk in cell):
                estimates[place, condition, measure] = estimate(cell, measure)
        upright[place, condition] = float(np.mean(scores(cell, "upright").mean(axis=1) >= 0.9))
        if place in ENVIRONMENTS and condition not in (REFERENCE, "untrained") and reference is not None:
            for measure in COMPARED:
                differences[place, condition, measure] = _compare(cell, reference, measure)
    corrected = statistics.holm({key: each.p for key, each in differences.items()})
    return Summary(estimates, upright, {key: replace(each, p=corrected[key]) for key, each in differences.items()})


def _compare(walks: Sequence[WalkRow], others: Sequence[WalkRow], measure: str) -> statistics.Comparison:
    """One condition compared with another in an environment, on the same walks, or on the robots that both walked."""
    one, other, statistic = scores(walks, measure), scores(others, measure), _statistic_of(measure)
    if walks[0]["condition"] in ADAPTED:  # the policy of seed k walks robot k, as does draw k of the others
        robots = min(len(one), other.shape[1])
        return statistics.compare_on_robots(one[:robots], other[:, :robots], statistic)
    return statistics.compare_scores(one, other, statistic)
