"""What a study compares, and whether its targets hold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from motorprior.transfer.places import TWINS
from motorprior.transfer.statistics import SURE, Comparison, Estimate, Statistic, iqms, means
from motorprior.transfer.walk_table import OWN, OWN_ABROAD

MEASURES = {
    "speed": "m/s", "upright": "1", "distance": "m", "heading_deg_per_m": "°/m", "lateral_share": "1", "drift": "m",
    "slip": "m/m", "transport": "1", "torque_beyond": "1", "step_frequency": "Hz", "foot_lift_mm": "mm",
    "body_rate": "rad/s",
}  # fmt: skip
"""Name -> unit, see `walk_measures`; the lift of every foot is foot_lift_mm/LEG."""
_MEANS = frozenset({"upright"})
"""Measures whose mean is reported: the middle half of a share near 1 says nothing of the falls."""
PRIOR_MEAN, PRIOR, ADAPTED, ROBUST_PRIOR, ORACLE = "prior_mean", "prior", "prior_adapted", "prior_robust", "oracle"
PAPER, PAPER_WIDE, ONE_NETWORK = "paper", "paper_wide", "one_network"
BASELINE, TUNED_PD = "ideal_pd", "tuned_pd"
RIVALS = PD_FRICTION, PD_RANDOMISED = "pd_friction", "pd_randomised"
"""Conditions that the prior must beat."""
UNTRAINED = "untrained"
"""The gait itself: one policy, which nothing trained."""
CONDITIONS = (
    UNTRAINED, BASELINE, TUNED_PD, *RIVALS, ONE_NETWORK, PAPER, PAPER_WIDE,
    PRIOR_MEAN, PRIOR, ADAPTED, ROBUST_PRIOR, ORACLE,
)  # fmt: skip
"""Of a study, in the order of every table and picture."""
HARD = "hard"
DECIDING = tuple(name for name in TWINS if name != HARD)
"""Twins on which the prior must be better than its rivals; on the hard one, too, it must not be worse."""
NOT_MEASURED = "not measured"


class Compared(NamedTuple):
    """How a measure is told. Attributes: more of it in words; its unit."""

    more: str
    unit: str


COMPARED = {"speed": Compared("faster", "m/s"), "upright": Compared("upright for longer", "points")}
"""Measures that conditions are compared by. Drift is none: it is known of who does not fall."""


def statistic_of(measure: str) -> Statistic:
    """What scores of a measure are summarised by."""
    return means if measure in _MEANS else iqms


STEPS = (
    (TUNED_PD, PD_FRICTION, "Coulomb friction"),
    (PD_FRICTION, PRIOR_MEAN, "the prior's mean motor in place of a PD"),
    (PRIOR_MEAN, PRIOR, "samples in place of the mean"),
    (PRIOR, ADAPTED, "10 s of the robot's own log"),
    (ADAPTED, ORACLE, "true motors of other robots"),
)
"""What each step from the tuned PD to the oracle changes: from, to, what it is."""
IN_WORDS = {
    PRIOR: "sampled", ADAPTED: "adapted", PD_FRICTION: "a PD with friction", PD_RANDOMISED: "a randomised PD",
    PAPER: "the paper's recipe", PAPER_WIDE: "the paper's loss on our data",
}  # fmt: skip
LEAST_SPEED = 0.02
"""[m/s]; a policy that is slower where it was trained does not walk, and has no transfer ratio."""
LEAST_UPRIGHT = 0.9
"""Share of the time; an oracle that is upright for less is no measure."""
ENOUGH_SPEED, ENOUGH_UPRIGHT, UPRIGHT_WHERE_HARD, TWINS_WON = 0.95, 0.98, 0.9, 2


@dataclass(frozen=True)
class Verdict:
    """Attributes: said, aimed at or claimed; holds, None where it cannot be told; found, in numbers; why not."""

    said: str
    holds: bool | None
    found: str
    why: str = ""


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
    standing: Mapping[tuple[str, str], float]
    """(place, condition) -> share of the policies that stand there."""

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
    verdicts = [_against_the_oracle(facts, place) for place in in_order((*TWINS, *twins), TWINS) if place != HARD]
    verdicts += [_against_a_rival(facts, rival, measure, twins) for measure in COMPARED for rival in RIVALS]
    upright = facts.value(HARD, ROBUST_PRIOR, "upright")
    said = f"{HARD}: the prior with body randomisation stays {100 * UPRIGHT_WHERE_HARD:.0f} % upright"
    if np.isfinite(upright):
        found, holds = _stands(facts, HARD, ROBUST_PRIOR), upright >= UPRIGHT_WHERE_HARD
        verdicts.append(Verdict(said, holds, found, "" if holds else f"{found}; {_uprightness_beside(facts)}"))
    else:
        verdicts.append(Verdict(said, None, NOT_MEASURED))
    return tuple(verdicts)


def _uprightness_beside(facts: Facts) -> str:
    """How upright it is where it was trained, and the oracle at this place."""
    own, best = facts.value(OWN, ROBUST_PRIOR, "upright"), facts.value(HARD, ORACLE, "upright")
    return f"where it was trained {percent_text(own)}; the oracle here {percent_text(best)}"


def _stands(facts: Facts, place: str, condition: str) -> str:
    """Time upright, and how many policies stand where some do not: do all fall at times, or some all the time?"""
    upright = f"{percent_text(facts.value(place, condition, 'upright'))} upright"
    share = facts.standing.get((place, condition), 1.0)
    return upright if share == 1.0 else f"{upright} ({percent_text(share)} of its policies stand)"


def _against_the_oracle(facts: Facts, place: str) -> Verdict:
    """One of the two ways of using the prior must be fast and safe; an oracle that falls is no measure of speed."""
    best, each_holds, found = Peer(*(facts.value(place, ORACLE, name) for name in ("speed", "upright"))), [], []
    for name in (PRIOR, ADAPTED):
        upright, speed = (facts.value(place, name, measure) for measure in ("upright", "speed"))
        oracle = facts.peers.get(place, best) if name == ADAPTED else best
        if not np.isfinite(upright):
            each_holds.append(None)
            continue
        stands = f"{IN_WORDS[name]} {_stands(facts, place, name)}"
        if oracle.upright < LEAST_UPRIGHT or not oracle.speed > 0.0:
            each_holds.append(None if upright >= ENOUGH_UPRIGHT else False)
            known = f"the oracle is no measure of its speed ({percent_text(oracle.upright)} upright)"
            found.append(f"{stands}; {known if np.isfinite(oracle.upright) else 'no oracle walks there'}")
            continue
        share = speed / oracle.speed
        each_holds.append(bool(share >= ENOUGH_SPEED and upright >= ENOUGH_UPRIGHT))
        found.append(f"{stands}, {percent_text(share)} of the speed")
    said = f"{place}: the prior has {100 * ENOUGH_SPEED:.0f} % of the oracle's speed"
    said = f"{said} and is {100 * ENOUGH_UPRIGHT:.0f} % upright"
    return Verdict(said, _either(each_holds), "; ".join(found) or NOT_MEASURED)


def _either(each_holds: list[bool | None]) -> bool | None:
    """Whether one of two ways holds; None where none does, and one cannot be told."""
    if True in each_holds:
        return True
    return None if None in each_holds or not each_holds else False


def _against_a_rival(facts: Facts, rival: str, measure: str, twins: list[str]) -> Verdict:
    """One of the two ways of using the prior must be better on enough of DECIDING, worse on no twin, beyond doubt."""
    met = {
        name: [each for place in twins if (each := Pairing(place, name, rival, measure)) in facts.comparisons]
        for name in (PRIOR, ADAPTED)
    }
    said = f"the prior is {COMPARED[measure].more} than {IN_WORDS[rival]}"
    found = "; ".join(
        f"{IN_WORDS[name]}: {_differences(facts, pairings)}" for name, pairings in met.items() if pairings
    )
    holds = _either([_wins(facts, each) for each in met.values()])
    has = ", ".join(_value_text(measure, facts.value(place, rival, measure)) for place in DECIDING)
    return Verdict(said, holds, found or NOT_MEASURED, _why_not_better(facts, met, has) if holds is False else "")


def _why_not_better(facts: Facts, met: Mapping[str, list[Pairing]], has: str) -> str:
    """On which twins either way of using the prior is better or worse beyond doubt, and how good the rival is."""
    ways = []
    for name, pairings in met.items():
        won = [each.place for each in pairings if _is_win(facts, each)]
        lost = [each.place for each in pairings if _is_loss(facts, each)]
        less = f" (less on {_listed(lost)}, uncorrected)" if lost else ""
        ways.append(f"{IN_WORDS[name]} on {_listed(won)}{less}")
    asked = f"{TWINS_WON} of {', '.join(DECIDING)} are asked, where the rival has {has}"
    return f"beyond doubt {'; '.join(ways)}; {asked}"


def _listed(names: list[str]) -> str:
    return " and ".join(names) or "none"


def _value_text(measure: str, value: float) -> str:
    return percent_text(value) if measure in _MEANS else f"{number_text(value, '.2f')} {COMPARED[measure].unit}"


def _wins(facts: Facts, pairings: list[Pairing]) -> bool | None:
    """Whether the first of each pair is better on enough of DECIDING and worse on no twin.

    A twin where they did not meet may be one where it is worse: then only a loss can be told. A correction makes a win
    harder to claim; a loss it would hide.
    """
    if any(_is_loss(facts, each) for each in pairings):
        return False
    if len({each.place for each in pairings} & set(TWINS)) < len(TWINS):
        return None
    return sum(each.place in DECIDING and _is_win(facts, each) for each in pairings) >= TWINS_WON


def _is_win(facts: Facts, pairing: Pairing) -> bool:
    """Whether the first of a pair is better, after the correction."""
    return _gain(facts, pairing) > 0.0 and _is_sure(facts, pairing)


def _is_sure(facts: Facts, pairing: Pairing) -> bool:
    return facts.comparisons[pairing].is_sure(facts.corrected[pairing])


def _is_loss(facts: Facts, pairing: Pairing) -> bool:
    """Whether the first of a pair is worse, before any correction."""
    return _gain(facts, pairing) < 0.0 and facts.comparisons[pairing].p < SURE


def _gain(facts: Facts, pairing: Pairing) -> float:
    """How much more the first of a pair has, in the measure's unit."""
    return facts.comparisons[pairing].difference.value


def _differences(facts: Facts, pairings: list[Pairing]) -> str:
    """Those beyond doubt and the losses one by one, and the range of the others."""
    shown, others = [], []
    for each in pairings:
        if _is_sure(facts, each):
            shown.append(f"{each.place} {_amount(facts, each)} (p {facts.corrected[each]:.2g})")
        elif _is_loss(facts, each):
            p = f"p {facts.comparisons[each].p:.2g} before the correction"
            shown.append(f"{each.place} {_amount(facts, each)} ({p})")
        else:
            others.append(each)
    if others:
        others.sort(key=lambda each: _gain(facts, each))
        ends = dict.fromkeys(_amount(facts, each) for each in (others[0], others[-1]))
        shown.append(f"{'elsewhere ' if shown else ''}{' to '.join(ends)}, not sure")
    return ", ".join(shown)


def _amount(facts: Facts, pairing: Pairing) -> str:
    value, unit = _gain(facts, pairing) + 0.0, COMPARED[pairing.measure].unit  # no −0
    return f"{number_text(100 * value, '+.1f')} points" if unit == "points" else f"{number_text(value, '+.3f')} {unit}"


def number_text(value: float, form: str) -> str:
    """In a format, with a true minus."""
    return format(value, form).replace("-", "−")


def percent_text(value: float) -> str:
    """A share in per cent, to a tenth."""
    return f"{100.0 * value:.1f} %" if np.isfinite(value) else "unknown"
