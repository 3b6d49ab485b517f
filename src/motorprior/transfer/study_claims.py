"""Whether what the paper says of its learned actuator holds on a table of walks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from motorprior.transfer.permutation_tests import holm
from motorprior.transfer.statistics import Comparison, compare_scores, iqm
from motorprior.transfer.study_verdicts import (
    BASELINE,
    LEAST_SPEED,
    MEASURES,
    NOT_MEASURED,
    PAPER,
    PAPER_WIDE,
    PRIOR,
    Verdict,
    number_text,
    percent_text,
    statistic_of,
    twins_in,
)
from motorprior.transfer.walk_table import OWN, WalkTable


class Claim(NamedTuple):
    """What is said of the paper's learned motors against the ideal PD.

    Attributes:
        said: in words.
        at_home: where policies were trained, or else on the first twin.
        measure: that shows it.
        sign: of the difference from the ideal PD.
    """

    said: str
    at_home: bool
    measure: str
    sign: int


CLAIMS = (
    Claim("it walks worse where it was trained", True, "speed", -1),
    Claim("its steps are less frequent", True, "step_frequency", -1),
    Claim("its feet lift higher", True, "foot_lift_mm", 1),
    Claim("it walks faster where it was not trained", False, "speed", 1),
    Claim("the body shakes less where it was not trained", False, "body_rate", -1),
    Claim("it falls less where it was not trained: it acts as a regulariser", False, "upright", 1),
)
_LEARNED = {
    PAPER: "the paper's recipe", PAPER_WIDE: "the paper's loss on our data",
    PRIOR: "the sampled prior, since no robot of the paper's loss walks at home",
}  # fmt: skip
"""Learned actuators, in words; the first that walks where it was trained is told of."""


class _Tested(NamedTuple):
    """Attributes: the comparison with the ideal PD; sign of the claim; what was found."""

    compared: Comparison
    sign: int
    found: str


def claims(table: WalkTable) -> tuple[Verdict, ...]:
    """What the paper says of its learned actuator against the ideal PD.

    Of the paper's recipe. Where its robot does not walk in the simulation that it was trained in, they are told of the
    first learned actuator that does: the paper's loss on our data, or the sampled prior. A claim is decided where the
    difference is sure, by Holm over the claims.
    """
    tested = {claim: _test(claim, table) for claim in CLAIMS}
    corrected = holm({claim: each.compared.p for claim, each in tested.items() if isinstance(each, _Tested)})
    return tuple(_verdict(claim, each, corrected.get(claim, 1.0)) for claim, each in tested.items())


def _verdict(claim: Claim, tested: _Tested | str, p: float) -> Verdict:
    """Whether a claim holds, by its corrected p."""
    if isinstance(tested, str):
        return Verdict(claim.said, None, tested)
    holds = tested.sign * tested.compared.difference.value > 0.0 if tested.compared.is_sure(p) else None
    return Verdict(claim.said, holds, f"{tested.found} (p {p:.2g})")


def _test(claim: Claim, table: WalkTable) -> _Tested | str:
    """A claim against the numbers, or why there is nothing to test."""
    place = OWN if claim.at_home else next(iter(twins_in(table.distinct("place"))), None)
    tried = [name for name in _LEARNED if len(table.at(OWN, name))]
    if place is None or PAPER not in tried:
        return NOT_MEASURED
    recipe = next((name for name in tried if _walks(table, name)), None)
    if recipe is None:
        return f"{_own_walk(table, PAPER)}: nothing can be told of it"
    measure, pair = claim.measure, (recipe, BASELINE)
    walks = [table.at(place, name) for name in pair]
    scores = [each.scores(place, name, measure) for name, each in zip(pair, walks, strict=True)]
    if not all(np.isfinite(each).any() for each in scores):
        return NOT_MEASURED
    statistic = statistic_of(measure)
    shared = place != OWN and walks[0].distinct("draw") == walks[1].distinct("draw")
    compared = compare_scores(*scores, shared=shared, statistic=statistic)
    paper, pd = (number_text(float(statistic(each.ravel())), ".3g") for each in scores)
    unit = "" if MEASURES[measure] == "1" else f" {MEASURES[measure]}"
    found = f"{place}: {paper}{unit} after {_LEARNED[recipe]}, {pd}{unit} after the ideal PD"
    return _Tested(compared, claim.sign, found)


def _walks(table: WalkTable, condition: str) -> bool:
    """Whether policies of a condition walk where they were trained."""
    return iqm(table.scores(OWN, condition, "speed")) >= LEAST_SPEED


def _own_walk(table: WalkTable, condition: str) -> str:
    """How policies walk where they were trained."""
    speed, upright = (table.scores(OWN, condition, measure) for measure in ("speed", "upright"))
    found = f"{number_text(iqm(speed), '.2f')} m/s, {percent_text(float(upright.mean()))} upright"
    return f"the robot does not walk in its own simulation ({found})"
