"""What a study decides: interquartile means with intervals, comparisons with corrected p values, targets, claims."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from motorprior.exceptions import ArtifactError
from motorprior.transfer.permutation_tests import holm
from motorprior.transfer.statistics import (
    Comparison,
    Estimate,
    compare_on_robots,
    compare_pairs,
    compare_scores,
    estimate,
    iqm,
    means,
    ratio,
)
from motorprior.transfer.study_claims import claims
from motorprior.transfer.study_losses import Cells, losses
from motorprior.transfer.study_targets import targets
from motorprior.transfer.study_verdicts import (
    ADAPTED,
    COMPARED,
    CONDITIONS,
    LEAST_SPEED,
    LEAST_UPRIGHT,
    OF_ONE_ROBOT,
    ORACLE,
    PRIOR,
    RIVALS,
    STEPS,
    UNTRAINED,
    Facts,
    Pairing,
    Peer,
    Verdict,
    home_of,
    in_order,
    statistic_of,
    twins_in,
)  # fmt: skip
from motorprior.transfer.walk_table import OWN, OWN_ABROAD, WalkTable

ENOUGH_POLICIES, ENOUGH_DRAWS = 8, 32
"""Of a condition, and walks of each of its policies at a twin, to decide anything: as many as the study asks for."""


@dataclass(frozen=True)
class Summary:
    """What a table of walks says.

    Attributes:
        estimates: (place, condition, measure) -> interquartile mean, of a share its mean, with interval.
        ratios: (twin, condition) -> speed there over the speed where it was trained; NaN where it does not walk there.
        regrets: (twin, condition) -> speed that the oracle walks faster [m/s]; the oracle has none.
        standing: (place, condition) -> share of the policies that are upright for LEAST_UPRIGHT of the time there.
        comparisons: of the measures COMPARED, see `families`; of the prior with the adapted one both ways.
        corrected: likewise, p by Holm over the family.
        targets: of the study.
        claims: of the paper.
        policies: fewest policies of one of CONDITIONS at a place, but the gait.
        draws: fewest walks of one of these policies at a twin.
        decides: whether there are enough of both; otherwise targets and claims cannot be told.
    """

    estimates: Mapping[tuple[str, str, str], Estimate]
    ratios: Mapping[tuple[str, str], Estimate]
    regrets: Mapping[tuple[str, str], Estimate]
    standing: Mapping[tuple[str, str], float]
    comparisons: Mapping[Pairing, Comparison]
    corrected: Mapping[Pairing, float]
    targets: tuple[Verdict, ...]
    claims: tuple[Verdict, ...]
    policies: int
    draws: int
    decides: bool

    def places(self) -> list[str]:
        """OWN, then the twins, see `twins_in`."""
        return [place for place in self.homes() if place != OWN_ABROAD] + self.twins()

    def homes(self) -> list[str]:
        """Where policies were trained: OWN, and OWN_ABROAD if some were for foreign motors."""
        return [place for place in (OWN, OWN_ABROAD) if any(place == known for known, *_ in self.estimates)]

    def twins(self) -> list[str]:
        """See `twins_in`."""
        return twins_in(place for place, *_ in self.estimates)

    def conditions(self) -> list[str]:
        """CONDITIONS that walked, then others in the order of the table."""
        return in_order((condition for _, condition, _ in self.estimates), CONDITIONS)


def summarise(table: WalkTable, enough_draws: int = ENOUGH_DRAWS) -> Summary:
    """Judge a table of walks.

    Args:
        table: of places, conditions, seeds and draws; what lacks a place or a condition lacks its comparisons.
        enough_draws: see ENOUGH_DRAWS.

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
    estimates = {
        (place, condition, measure): estimate(scores, statistic_of(measure))
        for (place, condition), cell in cells.items()
        for measure in cell.measures()
        for scores in (cell.scores(place, condition, measure),)
        if np.isfinite(scores).any()
    }
    standing = {pair: _standing(*pair, cell) for pair, cell in cells.items() if "upright" in cell.measures()}
    cells = {pair: cell for pair, cell in cells.items() if pair[0] != OWN_ABROAD}
    ratios = {pair: _ratio(pair, cells[pair], home) for pair, home in homes.items() if pair in cells}
    regrets = {
        (pairing.place, pairing.other): _compare(pairing, cells).difference
        for pairing in _pairings(ORACLE, cells, ("speed",))
    }
    comparisons, corrected = _compared(cells)
    policies, draws = _fewest(cells)
    decides = policies >= ENOUGH_POLICIES and draws >= enough_draws
    facts = Facts(estimates, comparisons, corrected, _peers(cells), standing, losses(cells))
    aims, said = targets(facts), claims(table)
    if not decides:
        aims, said = (tuple(replace(each, holds=None) for each in verdicts) for verdicts in (aims, said))
    return Summary(estimates, ratios, regrets, standing, comparisons, corrected, aims, said, policies, draws, decides)


def _fewest(cells: Cells) -> tuple[int, int]:
    """Policies of a condition at a place, and walks of each at a twin."""
    judged = {
        (place, condition): cell
        for (place, condition), cell in cells.items()
        if condition in CONDITIONS and condition != UNTRAINED
    }
    policies = min((len(cell.distinct("seed")) for cell in judged.values()), default=0)
    draws = min((len(cell.distinct("draw")) for (place, _), cell in judged.items() if place != OWN), default=0)
    return policies, draws


def _standing(place: str, condition: str, cell: WalkTable) -> float:
    return float(np.mean(cell.scores(place, condition, "upright").mean(axis=1) >= LEAST_UPRIGHT))


def _compared(cells: Cells) -> tuple[dict[Pairing, Comparison], dict[Pairing, float]]:
    """Comparisons of all families, and their p values, each corrected within its family."""
    comparisons, corrected = {}, {}
    for family in families(cells):
        found = {pairing: _compare(pairing, cells) for pairing in family}
        comparisons |= found
        corrected |= holm({pairing: each.p for pairing, each in found.items()})
    for pairing in [each for each in comparisons if (each.one, each.other) == (ADAPTED, PRIOR)]:
        turned = Pairing(pairing.place, PRIOR, ADAPTED, pairing.measure)
        comparisons[turned], corrected[turned] = comparisons[pairing].turned(), corrected[pairing]
    return comparisons, corrected


def families(cells: Cells) -> list[list[Pairing]]:
    """What is compared, on every twin where both walked, and what is corrected together.

    First what targets are judged by: the prior, sampled or adapted, with its RIVALS. Then each of STEPS with the one
    before it. Then the sampled prior with all other conditions that were trained. What was made for the same robots is
    compared in a family per measure: of eight pairs no p is below 2 / 256, which a larger family would hide.
    """
    steps = {(after, before) for before, after, _ in STEPS}
    targeted = [each for one in (PRIOR, ADAPTED) for each in _pairings(one, cells) if each.other in RIVALS]
    ones = dict.fromkeys(one for _, one, _ in STEPS)
    found = [each for one in ones for each in _pairings(one, cells) if (each.one, each.other) in steps]
    stepped = [each for each in found if not {each.one, each.other} <= OF_ONE_ROBOT]
    paired = [[each for each in found if each not in stepped and each.measure == measure] for measure in COMPARED]
    told = {*RIVALS, UNTRAINED, *(other for one, other in steps if one == PRIOR), ADAPTED}
    return [targeted, stepped, [each for each in _pairings(PRIOR, cells) if each.other not in told], *paired]


def _pairings(one: str, cells: Cells, measures: Iterable[str] = COMPARED) -> list[Pairing]:
    """Of one condition with every other on every twin where both walked."""
    return [
        Pairing(place, one, other, measure)
        for measure in measures
        for (place, other), cell in cells.items()
        if place != OWN and other != one and (place, one) in cells
        if measure in cell.measures() and measure in cells[place, one].measures()
    ]


def _compare(pairing: Pairing, cells: Cells) -> Comparison:
    """On the same draws where both walked them; policies OF_ONE_ROBOT have others, though of the same numbers."""
    place, one, other, measure = pairing
    mine, theirs, statistic = cells[place, one], cells[place, other], statistic_of(measure)
    if {one, other} <= OF_ONE_ROBOT:
        mine, theirs = _of_the_same_robots(mine, theirs)
        return compare_pairs(mine.scores(place, one, measure), theirs.scores(place, other, measure), statistic)
    if other in OF_ONE_ROBOT:
        return _compare(Pairing(place, other, one, measure), cells).turned()
    shared = one not in OF_ONE_ROBOT and mine.distinct("draw") == theirs.distinct("draw")
    on_robots = one in OF_ONE_ROBOT and bool(_common_robots(mine, theirs))
    if on_robots:
        mine, theirs = _on_the_same_robots(mine, theirs)
    first, second = mine.scores(place, one, measure), theirs.scores(place, other, measure)
    if on_robots:
        return compare_on_robots(first, second, statistic)
    return compare_scores(first, second, shared, statistic)


def _of_the_same_robots(one: WalkTable, other: WalkTable) -> tuple[WalkTable, WalkTable]:
    """Those of the walks of two conditions OF_ONE_ROBOT that are on robots of both."""
    robots = set(one.distinct("seed")) & set(other.distinct("seed"))
    mine, theirs = (WalkTable.of(walk for walk in each.walks if walk.seed in robots) for each in (one, other))
    return mine, theirs


def _common_robots(adapted: WalkTable, others: WalkTable) -> set[int]:
    """Seed k of what was adapted walks robot k, and so does draw k of everybody else."""
    return set(adapted.distinct("seed")) & set(others.distinct("draw"))


def _on_the_same_robots(adapted: WalkTable, others: WalkTable) -> tuple[WalkTable, WalkTable]:
    """Those of the walks of the adapted policies and of others that are on robots of both; all if there is none."""
    robots = _common_robots(adapted, others)
    if not robots:
        return adapted, others
    return (
        WalkTable.of(walk for walk in adapted.walks if walk.seed in robots),
        WalkTable.of(walk for walk in others.walks if walk.draw in robots),
    )


def _peers(cells: Cells) -> dict[str, Peer]:
    """See `Facts.peers`."""
    found = {}
    for (place, condition), cell in cells.items():
        if condition == ADAPTED and place != OWN and (place, ORACLE) in cells:
            there = _on_the_same_robots(cell, cells[place, ORACLE])[1]
            speed, upright = (there.scores(place, ORACLE, name) for name in ("speed", "upright"))
            found[place] = Peer(iqm(speed), float(means(upright.ravel())))
    return found


def _ratio(pair: tuple[str, str], there: WalkTable, own: WalkTable) -> Estimate:
    place, condition = pair
    home = own.walks[0].place
    if there.distinct("seed") != own.distinct("seed"):
        raise ArtifactError(
            f"{condition}: seeds {there.distinct('seed')} walked at {place}, {own.distinct('seed')} where trained",
            remedy=f"delete watched/{condition}_* in the study's folder and run it again",
        )
    return ratio(there.scores(place, condition, "speed"), own.scores(home, condition, "speed"), LEAST_SPEED)
