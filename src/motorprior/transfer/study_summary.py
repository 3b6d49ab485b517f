"""What a study decides: interquartile means with intervals, comparisons with corrected p values, targets, claims."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.transfer.places import ABROAD, TWINS
from motorprior.transfer.statistics import Comparison, Estimate, compare_scores, estimate, holm, iqm, iqms, means, ratio
from motorprior.transfer.study_verdicts import (
    ADAPTED,
    COMPARED,
    CONDITIONS,
    LEAST_SPEED,
    MEANS,
    ORACLE,
    PRIOR,
    RIVALS,
    STEPS,
    UNTRAINED,
    Facts,
    Pairing,
    Peer,
    Verdict,
    claims,
    in_order,
    targets,
    twins_in,
)  # fmt: skip
from motorprior.transfer.walk_table import OWN, OWN_ABROAD, WalkTable

ENOUGH_POLICIES = 8
"""Of a condition. The bootstrap of fewer finds differences that are not there: of pairs of equal conditions it calls
4 % different (p < 0.05) with 8 policies each, 8 % with 4, and 22 % with 2."""


@dataclass(frozen=True)
class Summary:
    """What a table of walks says.

    Attributes:
        estimates: (place, condition, measure) -> interquartile mean, of a share its mean, with interval.
        ratios: (twin, condition) -> speed there over the speed where it was trained; NaN where it does not walk there.
        regrets: (twin, condition) -> speed that the oracle walks faster [m/s]; the oracle has none.
        comparisons: of the measures COMPARED; of the prior with every condition, of the adapted prior with its RIVALS.
        corrected: likewise, p by Holm over all comparisons.
        steps: of the measures COMPARED, of each of STEPS on every twin where both its ends walked.
        steps_corrected: likewise, p by Holm over all of them.
        targets: of the study.
        claims: of the paper.
        policies: fewest policies of a trained condition at a place.
    """

    estimates: Mapping[tuple[str, str, str], Estimate]
    ratios: Mapping[tuple[str, str], Estimate]
    regrets: Mapping[tuple[str, str], Estimate]
    comparisons: Mapping[Pairing, Comparison]
    corrected: Mapping[Pairing, float]
    steps: Mapping[Pairing, Comparison]
    steps_corrected: Mapping[Pairing, float]
    targets: tuple[Verdict, ...]
    claims: tuple[Verdict, ...]
    policies: int

    def places(self) -> list[str]:
        """OWN, then the twins, see `twins_in`."""
        return in_order((place for place, *_ in self.estimates), (OWN, *self.twins()))

    def twins(self) -> list[str]:
        """See `twins_in`."""
        return twins_in(place for place, *_ in self.estimates)

    def conditions(self) -> list[str]:
        """CONDITIONS that walked, then others in the order of the table."""
        return in_order((condition for _, condition, _ in self.estimates), CONDITIONS)


def summarise(table: WalkTable, alone: frozenset[str] = frozenset({ADAPTED})) -> Summary:
    """Judge a table of walks.

    Args:
        table: of places, conditions, seeds and draws; what lacks a place or a condition lacks its comparisons.
        alone: conditions whose draws are not those of the others, though they have the same numbers.

    Raises:
        ArtifactError: not every policy walked every draw, or other policies walked on a twin than where they were
            trained.
    """
    cells = {
        (place, condition): there.at(place, condition)
        for place in table.distinct("place")
        for there in (table.at(place),)
        for condition in there.distinct("condition")
    }
    homes = {pair: cells[home] for pair in cells if pair[0] != OWN and (home := home_of(*pair, cells)) in cells}
    cells = {pair: cell for pair, cell in cells.items() if pair[0] != OWN_ABROAD}
    estimates = {
        (place, condition, measure): estimate(scores, means if measure in MEANS else iqms)
        for (place, condition), cell in cells.items()
        for measure in cell.measures()
        for scores in (cell.scores(place, condition, measure),)
        if np.isfinite(scores).any()
    }
    ratios = {pair: _ratio(pair, cells[pair], home) for pair, home in homes.items() if pair in cells}
    regrets = {
        (pairing.place, pairing.other): _compare(pairing, cells, alone).difference
        for pairing in _pairings(ORACLE, cells, ("speed",))
    }
    pairings = [*_pairings(PRIOR, cells), *(each for each in _pairings(ADAPTED, cells) if each.other in RIVALS)]
    comparisons = {pairing: _compare(pairing, cells, alone) for pairing in pairings}
    corrected = holm({pairing: each.p for pairing, each in comparisons.items()})
    steps = {
        each: _compare(each, cells, alone)
        for before, after, _ in STEPS
        for each in _pairings(after, cells)
        if each.other == before
    }
    judged = targets(Facts(estimates, comparisons, corrected, _peers(cells)))
    trained = (cell for (_, condition), cell in cells.items() if condition != UNTRAINED)
    policies = min((len(cell.distinct("seed")) for cell in trained), default=0)
    steps_corrected = holm({pairing: each.p for pairing, each in steps.items()})
    return Summary(
        estimates, ratios, regrets, comparisons, corrected, steps, steps_corrected, judged, claims(table), policies
    )


Cells = Mapping[tuple[str, str], WalkTable]


def _pairings(one: str, cells: Cells, measures: Iterable[str] = COMPARED) -> list[Pairing]:
    """Of one condition with every other on every twin where both walked."""
    return [
        Pairing(place, one, other, measure)
        for measure in measures
        for (place, other), cell in cells.items()
        if place != OWN and other != one and (place, one) in cells
        if measure in cell.measures() and measure in cells[place, one].measures()
    ]


def _compare(pairing: Pairing, cells: Cells, alone: frozenset[str]) -> Comparison:
    place, one, other, measure = pairing
    mine, theirs = cells[place, one], cells[place, other]
    shared = not alone & {one, other} and mine.distinct("draw") == theirs.distinct("draw")
    first, second = mine.scores(place, one, measure), theirs.scores(place, other, measure)
    if one == ADAPTED:
        second = second[:, _same_robots(mine, theirs)]
    elif other == ADAPTED:
        first = first[:, _same_robots(theirs, mine)]
    return compare_scores(first, second, shared, means if measure in MEANS else iqms)


def _same_robots(adapted: WalkTable, there: WalkTable) -> list[bool]:
    """Of the draws of others at a place, which are on robots that the adapted policies walk; all if none is.

    Seed k of the adapted prior walks robot k, and so does draw k of everybody else.
    """
    walked = [draw in adapted.distinct("seed") for draw in there.distinct("draw")]
    return walked if any(walked) else [True] * len(walked)


def _peers(cells: Cells) -> dict[str, Peer]:
    """See `Facts.peers`."""
    found = {}
    for (place, condition), cell in cells.items():
        if condition == ADAPTED and place != OWN and (place, ORACLE) in cells:
            there = cells[place, ORACLE]
            robots = _same_robots(cell, there)
            speed, upright = (there.scores(place, ORACLE, name)[:, robots] for name in ("speed", "upright"))
            found[place] = Peer(iqm(speed), float(means(upright.ravel())))
    return found


def home_of(place: str, condition: str, known: Container[tuple[str, str]]) -> tuple[str, str]:
    """Where, of the known (place, condition), the policies of a condition that walk at a twin were trained."""
    abroad = place in TWINS and TWINS[place].population == ABROAD and (OWN_ABROAD, condition) in known
    return (OWN_ABROAD if abroad else OWN), condition


def _ratio(pair: tuple[str, str], there: WalkTable, own: WalkTable) -> Estimate:
    place, condition = pair
    home = own.walks[0].place
    if there.distinct("seed") != own.distinct("seed"):
        raise ArtifactError(
            f"{condition}: seeds {there.distinct('seed')} walked at {place}, {own.distinct('seed')} where trained",
            remedy="delete the study's folder and run it again",
        )
    return ratio(there.scores(place, condition, "speed"), own.scores(home, condition, "speed"), LEAST_SPEED)
