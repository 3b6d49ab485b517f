"""Whether a study's targets hold, and why where they do not."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.transfer.places import TWINS
from motorprior.transfer.statistics import SURE
from motorprior.transfer.study_verdicts import (
    ADAPTED,
    COMPARED,
    DECIDING,
    ENOUGH_SPEED,
    ENOUGH_UPRIGHT,
    HARD,
    IN_WORDS,
    LEAST_UPRIGHT,
    MEANS,
    MOST_OF_IT,
    NOT_MEASURED,
    ORACLE,
    PRIOR,
    RIVALS,
    ROBUST_PRIOR,
    TWINS_WON,
    UPRIGHT_WHERE_HARD,
    Facts,
    Pairing,
    Peer,
    Verdict,
    home_of,
    in_order,
    number_text,
    percent_text,
)


def targets(facts: Facts) -> tuple[Verdict, ...]:
    """Whether the prior transfers: against the oracle on every twin, against its rivals, and on the hard one."""
    twins = facts.twins()
    verdicts = [_against_the_oracle(facts, place) for place in in_order((*TWINS, *twins), TWINS) if place != HARD]
    verdicts += [_against_a_rival(facts, rival, measure, twins) for measure in COMPARED for rival in RIVALS]
    upright = facts.value(HARD, ROBUST_PRIOR, "upright")
    said = f"{HARD}: the prior with body randomisation stays {100 * UPRIGHT_WHERE_HARD:.0f} % upright"
    if np.isfinite(upright):
        found, holds = _stands(facts, HARD, ROBUST_PRIOR), upright >= UPRIGHT_WHERE_HARD
        ends = (_where_it_falls(facts, HARD, ROBUST_PRIOR), _oracle_here(facts, HARD))
        why = "; ".join((found, _at_home(facts, HARD, ROBUST_PRIOR), *filter(None, ends)))
        verdicts.append(Verdict(said, holds, found, "" if holds else why))
    else:
        verdicts.append(Verdict(said, None, NOT_MEASURED))
    return tuple(verdicts)


def _at_home(facts: Facts, place: str, condition: str) -> str:
    """How upright the policies of a condition that walk at a place are where they were trained."""
    return f"where it was trained {percent_text(facts.value(*home_of(place, condition, facts.standing), 'upright'))}"


def _oracle_here(facts: Facts, place: str) -> str:
    return f"the oracle here {percent_text(facts.value(place, ORACLE, 'upright'))}"


def _where_it_falls(facts: Facts, place: str, condition: str) -> str:
    """On how many robots most of its falls are, and whether the oracle stands there; nothing where none is known."""
    loss = facts.losses.get((place, condition))
    if loss is None:
        return ""
    share = f"{100.0 * MOST_OF_IT:.0f} % of what is lost is on {loss.worst} of {loss.robots} robots"
    there = f", where it is {percent_text(loss.upright)} upright"
    return f"{share}{there}" + (f", the oracle {percent_text(loss.oracle)}" if np.isfinite(loss.oracle) else "")


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
    holds = _either(each_holds)
    return Verdict(said, holds, "; ".join(found) or NOT_MEASURED, _why_behind(facts, place) if holds is False else "")


def _why_behind(facts: Facts, place: str) -> str:
    """What each way of using the prior lacks, and whether it fell where it was trained or the oracle falls here."""
    ways = []
    for name in (PRIOR, ADAPTED):
        upright = facts.value(place, name, "upright")
        lacks = "falls" if upright < ENOUGH_UPRIGHT else "is slow"
        ways.append(f"{IN_WORDS[name]} {lacks}: {percent_text(upright)} upright, {_at_home(facts, place, name)}")
        if upright < ENOUGH_UPRIGHT and (where := _where_it_falls(facts, place, name)):
            ways.append(where)
    return f"{'; '.join(ways)}; {_oracle_here(facts, place)}"


def _either(each_holds: list[bool | None]) -> bool | None:
    """Whether one of two ways holds; None where none does, and one cannot be told."""
    if True in each_holds:
        return True
    return None if None in each_holds or not each_holds else False


def _against_a_rival(facts: Facts, rival: str, measure: str, twins: list[str]) -> Verdict:
    """One of the two ways of using the prior must be better beyond doubt on enough of DECIDING, and worse on none."""
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
        less = f" (less on {_listed(lost)}, however unsure)" if lost else ""
        unsure = [each.place for each in pairings if _is_sure_alone(facts, each) and each.place not in (*won, *lost)]
        alone = f" (before the correction also on {_listed(unsure)})" if unsure else ""
        ways.append(f"{IN_WORDS[name]} on {_listed(won)}{alone}{less}")
    asked = f"{TWINS_WON} of {', '.join(DECIDING)} are asked, where the rival has {has}"
    return f"beyond doubt {'; '.join(ways)}; {asked}"


def _listed(names: list[str]) -> str:
    return " and ".join(names) or "none"


def _value_text(measure: str, value: float) -> str:
    return percent_text(value) if measure in MEANS else f"{number_text(value, '.2f')} {COMPARED[measure].unit}"


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


def _is_sure_alone(facts: Facts, pairing: Pairing) -> bool:
    """Whether it would be sure if nothing else had been compared."""
    return facts.comparisons[pairing].is_sure(facts.comparisons[pairing].p)


def _is_loss(facts: Facts, pairing: Pairing) -> bool:
    """Whether the first of a pair is worse, before any correction, or by so much that it counts whatever its p."""
    gain = _gain(facts, pairing)
    return gain < -COMPARED[pairing.measure].loss or (gain < 0.0 and facts.comparisons[pairing].p < SURE)


def _gain(facts: Facts, pairing: Pairing) -> float:
    """How much more the first of a pair has, in the measure's unit."""
    return facts.comparisons[pairing].difference.value


def _differences(facts: Facts, pairings: list[Pairing]) -> str:
    """Those beyond doubt, losses, and what the correction alone makes unsure one by one; the range of the others."""
    shown, others = [], []
    for each in pairings:
        if _is_sure(facts, each):
            shown.append(f"{each.place} {_amount(facts, each)} (p {facts.corrected[each]:.2g})")
        elif _is_loss(facts, each):
            p = f"p {facts.comparisons[each].p:.2g} before the correction"
            shown.append(f"{each.place} {_amount(facts, each)} ({p})")
        elif _is_sure_alone(facts, each):
            p = f"p {facts.comparisons[each].p:.2g}, after the correction {facts.corrected[each]:.2g}"
            shown.append(f"{each.place} {_amount(facts, each)} ({p}: not sure)")
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
