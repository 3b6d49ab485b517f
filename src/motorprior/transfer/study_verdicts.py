"""Whether the targets of a study, and the paper's claims, hold on a table of walks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from motorprior.transfer.places import TWINS
from motorprior.transfer.statistics import Comparison, Estimate, compare_scores, iqm, iqms, means
from motorprior.transfer.walk_table import OWN, OWN_ABROAD, WalkTable

MEASURES = {
    "speed": "m/s", "upright": "1", "distance": "m", "heading_deg_per_m": "°/m", "lateral_share": "1", "drift": "m",
    "slip": "m/m", "transport": "1", "torque_beyond": "1", "step_frequency": "Hz", "foot_lift_mm": "mm",
    "body_rate": "rad/s",
}  # fmt: skip
"""Name -> unit, see `walk_measures`; the lift of every foot is foot_lift_mm/LEG."""
MEANS = frozenset({"upright"})
"""Measures whose mean is reported: the middle half of a share near 1 says nothing of the falls."""
PRIOR_MEAN, PRIOR, ADAPTED, ROBUST_PRIOR, ORACLE = "prior_mean", "prior", "prior_adapted", "prior_robust", "oracle"
PAPER, PAPER_WIDE, BASELINE, TUNED_PD = "paper", "paper_wide", "ideal_pd", "tuned_pd"
RIVALS = PD_FRICTION, PD_RANDOMISED = "pd_friction", "pd_randomised"
"""Conditions that the prior must beat."""
UNTRAINED = "untrained"
"""The gait itself: one policy, which nothing trained."""
CONDITIONS = (
    UNTRAINED, BASELINE, TUNED_PD, *RIVALS, "one_network", PAPER, PAPER_WIDE,
    PRIOR_MEAN, PRIOR, ADAPTED, ROBUST_PRIOR, ORACLE,
)  # fmt: skip
"""Of a study, in the order of every table and picture."""
HARD = "hard"


class Compared(NamedTuple):
    """How a measure is told. Attributes: better in words; +1 if more of it is better, else -1; its unit."""

    better: str
    sign: int
    unit: str


COMPARED = {
    "speed": Compared("faster", 1, "m/s"),
    "upright": Compared("upright for longer", 1, "points"),
    "drift": Compared("straighter", -1, "m"),
}
"""Measures that conditions are compared by."""


def better(measure: str, difference: Estimate) -> Estimate:
    """A difference of a measure as how much better the first is."""
    if COMPARED[measure].sign > 0:
        return difference
    return Estimate(-difference.value, -difference.high, -difference.low)


STEPS = (
    (TUNED_PD, PD_FRICTION, "Coulomb friction"),
    (PD_FRICTION, PRIOR_MEAN, "the prior's mean motor in place of a PD"),
    (PRIOR_MEAN, PRIOR, "samples in place of the mean"),
    (PRIOR, ADAPTED, "10 s of the robot's own log"),
    (ADAPTED, ORACLE, "true motors of other robots"),
)
"""What each step from the tuned PD to the oracle changes: from, to, what it is."""
SURE = 0.05
"""P value below which a difference is no accident."""
_IN_WORDS = {
    PRIOR: "sampled", ADAPTED: "adapted", PD_FRICTION: "a PD with friction", PD_RANDOMISED: "a randomised PD",
    PAPER: "the paper's recipe", PAPER_WIDE: "the paper's loss on our data",
}  # fmt: skip
CLAIMS = (
    "it walks worse where it was trained", "its steps are less frequent", "its feet lift higher",
    "it walks faster where it was not trained", "the body shakes less where it was not trained",
    "it falls less where it was not trained: it acts as a regulariser",
)  # fmt: skip
"""Of the paper, about its learned motors."""
LEAST_SPEED = 0.02
"""[m/s]; a policy that is slower where it was trained does not walk, and has no transfer ratio."""
LEAST_UPRIGHT = 0.9
"""Share of the time; an oracle that is upright for less is no measure."""
ENOUGH_SPEED, ENOUGH_UPRIGHT, UPRIGHT_WHERE_HARD, TWINS_WON = 0.95, 0.98, 0.9, 2


@dataclass(frozen=True)
class Verdict:
    """Attributes: what is aimed at or claimed; whether it holds, None where it cannot be told; what was found."""

    said: str
    holds: bool | None
    found: str


class Pairing(NamedTuple):
    """Attributes: a place; two conditions that walked there, of which the second is taken from the first; a measure."""

    place: str
    one: str
    other: str
    measure: str


class Peer(NamedTuple):
    """What others are measured by. Attributes: its speed [m/s]; share of the time that it is upright [-]."""

    speed: float
    upright: float


@dataclass(frozen=True)
class Facts:
    """What the targets are judged by; see `study_summary.Summary`."""

    estimates: Mapping[tuple[str, str, str], Estimate]
    comparisons: Mapping[Pairing, Comparison]
    corrected: Mapping[Pairing, float]
    peers: Mapping[str, Peer]
    """Place -> the oracle on the robots that the adapted policies walk there."""

    def value(self, place: str, condition: str, measure: str) -> float:
        """Of an estimate; NaN without one."""
        found = self.estimates.get((place, condition, measure))
        return float("nan") if found is None else found.value

    def twins(self) -> list[str]:
        """See `twins_in`."""
        return twins_in(place for place, *_ in self.estimates)


def twins_in(places: Iterable[str]) -> list[str]:
    """Those of some places where no policy was trained, each once: TWINS in their order, then others."""
    return in_order((place for place in places if place not in (OWN, OWN_ABROAD)), TWINS)


def in_order(names: Iterable[str], order: Iterable[str]) -> list[str]:
    """Names, each once: those of an order in it, then the others as they come."""
    found = list(dict.fromkeys(names))
    known = [name for name in order if name in found]
    return known + [name for name in found if name not in known]


def targets(facts: Facts) -> tuple[Verdict, ...]:
    """Whether the prior transfers: against the oracle on every twin, against its rivals, and on the hard one."""
    twins = facts.twins()
    verdicts = [_against_the_oracle(facts, place) for place in twins if place != HARD]
    verdicts += [_against_a_rival(facts, rival, measure, twins) for measure in COMPARED for rival in RIVALS]
    if HARD in twins:
        upright = facts.value(HARD, ROBUST_PRIOR, "upright")
        said = f"{HARD}: the prior with body randomisation stays {100 * UPRIGHT_WHERE_HARD:.0f} % upright"
        verdicts.append(Verdict(said, _told(upright >= UPRIGHT_WHERE_HARD, upright), f"{_percent(upright)} upright"))
    return tuple(verdicts)


def _against_the_oracle(facts: Facts, place: str) -> Verdict:
    """One of the two ways of using the prior must be both fast and safe; an oracle that falls is no measure."""
    best, each_holds, found = Peer(*(facts.value(place, ORACLE, name) for name in ("speed", "upright"))), [], []
    for name in (PRIOR, ADAPTED):
        upright, speed = (facts.value(place, name, measure) for measure in ("upright", "speed"))
        oracle = facts.peers.get(place, best) if name == ADAPTED else best
        if oracle.upright < LEAST_UPRIGHT:
            found.append(f"{_IN_WORDS[name]}: the oracle itself falls there ({_percent(oracle.upright)} upright)")
            continue
        share = speed / oracle.speed if oracle.speed > 0.0 else float("nan")
        each_holds.append(_told(share >= ENOUGH_SPEED and upright >= ENOUGH_UPRIGHT, share, upright))
        found.append(f"{_IN_WORDS[name]} {_percent(share)} of the speed, {_percent(upright)} upright")
    told = [each for each in each_holds if each is not None]
    said = f"{place}: the prior has {100 * ENOUGH_SPEED:.0f} % of the oracle's speed"
    return Verdict(f"{said} and is {100 * ENOUGH_UPRIGHT:.0f} % upright", any(told) if told else None, "; ".join(found))


def _against_a_rival(facts: Facts, rival: str, measure: str, twins: list[str]) -> Verdict:
    """One of the two ways of using the prior must be better on enough twins and worse on none, both beyond doubt."""
    ways = {name: [Pairing(place, name, rival, measure) for place in twins] for name in (PRIOR, ADAPTED)}
    met = {name: [pairing for pairing in ways[name] if pairing in facts.comparisons] for name in ways}
    won = [_wins(facts, pairings) for pairings in met.values()]
    said = f"the prior is {COMPARED[measure].better} than {_IN_WORDS[rival]}"
    found = "; ".join(
        f"{_IN_WORDS[name]}: {_differences(facts, pairings)}" for name, pairings in met.items() if pairings
    )
    known = [each for each in won if each is not None]
    return Verdict(said, any(known) if known else None, found or "not measured")


def _wins(facts: Facts, pairings: list[Pairing]) -> bool | None:
    """Whether the first of each pair is better on enough twins and worse on none.

    A single twin may show a loss, never a win.
    """
    sure = [_gain(facts, each) for each in pairings if facts.corrected[each] < SURE]
    won, lost = sum(value > 0.0 for value in sure), sum(value < 0.0 for value in sure)
    return (won >= TWINS_WON and not lost) if lost or len(pairings) >= TWINS_WON else None


def _gain(facts: Facts, pairing: Pairing) -> float:
    """How much better the first of a pair is, in the measure's unit."""
    return better(pairing.measure, facts.comparisons[pairing].difference).value


def _differences(facts: Facts, pairings: list[Pairing]) -> str:
    """Those beyond doubt one by one, and the range of the others."""
    sure = [each for each in pairings if facts.corrected[each] < SURE]
    shown = [f"{each.place} {_amount(facts, each)} (p {facts.corrected[each]:.2g})" for each in sure]
    others = sorted(set(pairings) - set(sure), key=lambda each: _gain(facts, each))
    if others:
        ends = dict.fromkeys(_amount(facts, each) for each in (others[0], others[-1]))
        shown.append(f"{'elsewhere ' if sure else ''}{' to '.join(ends)}, not sure")
    return ", ".join(shown)


def _amount(facts: Facts, pairing: Pairing) -> str:
    value, unit = _gain(facts, pairing) + 0.0, COMPARED[pairing.measure].unit  # no −0
    return f"{_number(100 * value, '+.1f')} points" if unit == "points" else f"{_number(value, '+.3f')} {unit}"


def claims(table: WalkTable) -> tuple[Verdict, ...]:
    """What the paper says of its learned actuator against the ideal PD.

    Measured on the paper's recipe or, where its robot does not walk in the simulation that it was trained in, so that
    nothing was learned, on the paper's loss with our data. Where that does not walk either, no claim can be judged. A
    claim is decided where the difference has p < SURE, one by one: their number is not corrected for. What is said of
    another place is of the first twin.
    """
    tried = [name for name in (PAPER, PAPER_WIDE) if len(table.at(OWN, name))]
    recipe = next((name for name in tried if _walks(table, name)), None)
    if recipe is None:
        found = f"{_own_walk(table, tried[0])}: nothing was learned that could be judged" if tried else "not measured"
        return tuple(Verdict(said, None, found) for said in CLAIMS)
    twin = next(iter(twins_in(table.distinct("place"))), None)
    return (
        _claim(CLAIMS[0], table, recipe, OWN, "speed", -1),
        _claim(CLAIMS[1], table, recipe, OWN, "step_frequency", -1),
        _claim(CLAIMS[2], table, recipe, OWN, "foot_lift_mm", 1),
        _claim(CLAIMS[3], table, recipe, twin, "speed", 1),
        _claim(CLAIMS[4], table, recipe, twin, "body_rate", -1),
        _claim(CLAIMS[5], table, recipe, twin, "upright", 1),
    )


def _walks(table: WalkTable, condition: str) -> bool:
    """Whether policies of a condition walk where they were trained."""
    return iqm(table.scores(OWN, condition, "speed")) >= LEAST_SPEED


def _own_walk(table: WalkTable, condition: str) -> str:
    """How policies walk where they were trained."""
    speed, upright = (table.scores(OWN, condition, measure) for measure in ("speed", "upright"))
    found = f"{_number(iqm(speed), '.2f')} m/s, {_percent(float(upright.mean()))} upright"
    return f"the robot does not walk in its own simulation ({found})"


def _claim(said: str, table: WalkTable, recipe: str, place: str | None, measure: str, sign: int) -> Verdict:
    """Whether the difference of a recipe from the baseline has a sign."""
    if place is None:
        return Verdict(said, None, "not measured")
    walks = {name: table.at(place, name) for name in (recipe, BASELINE)}
    scores = {name: each.scores(place, name, measure) for name, each in walks.items()}
    if not all(np.isfinite(each).any() for each in scores.values()):
        return Verdict(said, None, "not measured")
    shared = place != OWN and walks[recipe].distinct("draw") == walks[BASELINE].distinct("draw")
    statistic = means if measure in MEANS else iqms
    compared = compare_scores(scores[recipe], scores[BASELINE], shared, statistic)
    paper, pd = (_number(float(statistic(each.ravel())), ".3g") for each in scores.values())
    unit = "" if MEASURES[measure] == "1" else f" {MEASURES[measure]}"
    found = f"{place}: {paper}{unit} after {_IN_WORDS[recipe]}, {pd}{unit} after the ideal PD (p {compared.p:.2g})"
    return Verdict(said, bool(sign * compared.difference.value > 0.0) if compared.p < SURE else None, found)


def _told(condition: bool, *values: float) -> bool | None:
    return bool(condition) if np.isfinite(values).all() else None


def _number(value: float, form: str) -> str:
    return format(value, form).replace("-", "−")


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f} %" if np.isfinite(value) else "unknown"
