"""Which terms of `servo_terms` the data ask for: left out one by one where held-out free runs do without them.

Some motors are fitted on every second segment of their logs and judged on the others. All terms are fitted at once
first, since some are worth nothing without another: an encoder on the output needs the joint's own damping, or the
joint rattles in its play. With so many constants one random search ends in a poor optimum, in which terms seem useless,
so there are several, and one that begins at a fit with the terms of SERVO alone; of every motor the best counts. Then
each term is left out in turn, the rarest first. The fit is polished without it and, if it then seems to be missed, made
anew from the beginning, as a term changes where the other constants belong. It stays if it is worth its price,

    median over motors of log(loss with it / loss without) < log(1 - PRICE),   Wilcoxon's signed-rank test at 20 %

(at 5 % each, few motors refuse terms that they have and that help on held-out motion; of fewer than five motors the
test is of the held-out stretches of each). A term may have made up for one that is gone by then: those that stayed and
saved no more than SURE are left out in turn again, until none leaves. A term may have left because the fit with it had
ended in a poor optimum: each that left is tried once more beside those that stayed, from where their fit is, by the
same price and the test at 5 %. In the end all are compared with no term at all, likewise. Where the conditions of
segments differ, the terms of these are tried by themselves as well: of few logs, a fit of all terms at once may be too
poor to show them. A term is not asked about where the log states a value for it, which motors have, nor where the log
states that all of it is off, nor of conditions that are the same in all segments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.stats import wilcoxon

from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.servo_terms import FAINT, in_order
from motorprior.identification.physics.fleet_fit import TURNS, fit_fleet, held_constants, weak_belief
from motorprior.identification.physics.initial_motor import encoded, with_motor
from motorprior.identification.physics.motor_fit import MotorFit, of_either
from motorprior.identification.physics.window_runs import WindowRuns

PRICE = 0.04  # Share of the held-out loss that a term must save
# Most motors that are fitted; about the most rows of each, or more if fewer windows than these are in them
MOTORS, ROWS, WINDOWS = 8, 10_000, 60
SERVO = ("profile", "output_encoder", "dead_zone", "output_damping")  # What the servos of hobby robots have
# Stretches of a log of few segments; from so many segments of many motors on, these are the stretches
STRETCHES, FEWEST = 32, 4
# Terms that only logs under several conditions show, in the order of `Segment.conditions`, and the least difference
# between two segments: a share of the usual voltage, and [K]
VARIES = {"supply": 0.03, "temperature": 10.0}
# The term that says what one of `motor_log.CONDITIONS` does
TERM_OF = {"supply_voltage": "supply", "motor_temperature": "temperature"}
# In which terms are left out
ORDER = (
    "heat", "temperature", "supply", "asymmetry", "presliding", "current", "dead_zone", "integral", "output_encoder",
    "output_damping", "torque_speed", "profile",
)  # fmt: skip
# Of the signed-rank test of a term's gain and of all terms', and the least number of gains that can reach these:
# from fewer no term is chosen
_LEVEL, _LEVEL_OF_ALL, _RANKS_TELL = 0.2, 0.05, 5
_NO_LOSS = 1e-9  # A loss below counts as none
_TURNS = (*TURNS[:3], *TURNS[-2:])
_STEPS = 10
SURE = 0.3  # Share of the held-out loss: a term that saved more in one turn is not left out in the next
_ATTEMPTS = 3  # Random searches for a fit of all terms


@dataclass(frozen=True)
class Selection:
    """Terms, and what each saved.

    ``saved`` maps each term to the share of the held-out loss that it saved (negative: that it cost).
    """

    terms: tuple[str, ...]
    saved: dict[str, float]


@dataclass(frozen=True)
class _State:
    """Fits (m, P) of motors with these terms, as decoder outputs, and their losses.

    ``fitted`` and ``held_out`` (m,), and ``parts`` (m, s), those held out by stretch.
    """

    terms: tuple[str, ...]
    raw: np.ndarray
    fitted: np.ndarray
    held_out: np.ndarray
    parts: np.ndarray


def select_terms(
    network: LatentNetwork, runs: WindowRuns, seed: int, report: Callable[[str], None] = lambda text: None
) -> Selection:
    """Choose terms for the motors of ``runs``.

    Args:
        network: with a residual that stays as it is.
        runs: logs of m motors; MOTORS of a fleet are enough.
        seed: of the searches.
        report: called once for every term of ORDER in the first turn, then once for every fit of a further turn, and
            for every term that is taken back.
    """
    parts = stretches(runs, segments_to_choose_by(runs.num_motors))
    told, off = runs.preset.stated_terms, (*runs.preset.terms_that_are_off, *same_conditions(runs))
    tried = tuple(name for name in ORDER if name not in off)
    judged = parts % 2 == 1
    if judged.all() or not judged.any():  # too short a log to judge anything by
        return Selection(told, {})
    trial = _Trial(network, runs, parts, seed)
    whole, saved = trial.all_at_once(tried, (*(name for name in SERVO if name not in off), *told)), {}
    for name in ORDER:
        if name in (*told, *off):
            report(f"{name}: {'stated' if name in told else 'not tried'}")
    best = trial.that_pay(whole, told, saved, report)
    if varied := tuple(name for name in VARIES if name not in off):
        saved_alone: dict[str, float] = {}
        alone = trial.that_pay(trial.fitted((*varied, *told)), told, saved_alone, report)
        if _worth(best, alone, _LEVEL_OF_ALL):
            best, saved = alone, saved_alone
    if best.terms != told:
        bare = _better(trial.polished(best, told), trial.fitted(told))
        best = best if _worth(bare, best, _LEVEL_OF_ALL) else bare
    return Selection(best.terms, saved)


def least_difference(condition: str, usual: float) -> float:
    """Of VARIES, in the unit of one of `motor_log.CONDITIONS` [V], [°C] whose usual value this is."""
    least = VARIES[TERM_OF[condition]]
    return least * usual if condition == "supply_voltage" else least


def same_conditions(runs: WindowRuns) -> tuple[str, ...]:
    """Terms of VARIES whose condition is about the same in all segments, or was not stated."""
    apart = np.ptp([segment.conditions for segment in runs.segments], axis=0).max(axis=1)
    return tuple(name for (name, least), far in zip(VARIES.items(), apart, strict=True) if far < least)


def _saved(before: _State, after: _State) -> float:
    """Share of the held-out loss, median over motors."""
    return 1.0 - float(np.exp(np.median(_logarithm(after.held_out) - _logarithm(before.held_out))))


def _worth(before: _State, after: _State, level: float) -> bool:
    """Whether the fits ``after`` are worth the terms that those ``before`` lack.

    They are if they save more than PRICE of the held-out loss and the signed-rank test says so at this ``level``, from
    the gains of all motors or, of fewer than _RANKS_TELL motors, of their stretches.
    """
    if len(before.held_out) >= _RANKS_TELL:
        gains = _logarithm(before.held_out) - _logarithm(after.held_out)
    else:
        gains = (_logarithm(before.parts) - _logarithm(after.parts)).ravel()
    if len(gains) < _RANKS_TELL or not gains.any():
        return False
    pvalue = float(cast(Any, wilcoxon(gains, alternative="greater")).pvalue)
    return _saved(before, after) > PRICE and pvalue < level


def _logarithm(loss: np.ndarray) -> np.ndarray:
    """Of losses that may be 0: in a stretch at rest, a motor that rests is right."""
    return np.log(loss + _NO_LOSS)


class _Trial:
    """Fits to the windows in every second of these ``parts`` (N,), `stretches`, judged on the others."""

    def __init__(self, network: LatentNetwork, runs: WindowRuns, parts: np.ndarray, seed: int):
        self._network, self._runs, self._parts, self._seed = network, runs, parts, seed
        self._seen, self._unseen = parts % 2 == 0, parts % 2 == 1

    def fitted(self, terms: tuple[str, ...], attempt: int = 0) -> _State:
        """From the beginning."""
        terms, seed = in_order(terms), self._seed + attempt
        found = fit_fleet(self._network, self._runs, terms, True, seed, chosen=self._seen, turns=_TURNS)
        return self._state(terms, found.center, found.offsets)

    def all_at_once(self, tried: tuple[str, ...], servo: tuple[str, ...]) -> _State:
        """Of every motor the best of several fits of all terms; one of them begins with those of a ``servo`` alone."""
        best = self.polished(self.fitted(servo), in_order(tried))
        for attempt in range(_ATTEMPTS):
            best = _better(best, self.fitted(tried, attempt))
        return best

    def that_pay(
        self, best: _State, told: tuple[str, ...], saved: dict[str, float], report: Callable[[str], None]
    ) -> _State:
        """Without the terms that are not missed, one by one until none leaves; with those that pay beside the rest."""
        before, tried = (), best.terms
        while best.terms != before:
            before = best.terms
            best = self.left_out_in_turn(best, told, saved, report)
        return self.taken_back(best, tried, saved, report)

    def taken_back(
        self, best: _State, tried: tuple[str, ...], saved: dict[str, float], report: Callable[[str], None]
    ) -> _State:
        """Try each term that left beside those that stayed, the commonest first, and keep those that pay."""
        same = self.polished(best, best.terms)
        for name in [name for name in reversed(ORDER) if name in tried and name not in best.terms]:
            more = self.polished(best, in_order((*best.terms, name)))
            if _worth(same, more, _LEVEL_OF_ALL):
                best, saved[name] = more, _saved(same, more)
                same = self.polished(best, best.terms)
                report(f"{name}: taken back, saves {100 * saved[name]:.0f} %")
        return best

    def left_out_in_turn(
        self, best: _State, told: tuple[str, ...], saved: dict[str, float], report: Callable[[str], None]
    ) -> _State:
        """Each of the terms but ``told``, the rarest first, unless sure by then; what each saves goes to ``saved``."""
        for name in [name for name in ORDER if name in best.terms and name not in told]:
            if saved.get(name, 0.0) > SURE:
                continue
            less = self.polished(best, tuple(other for other in best.terms if other != name))
            if _worth(less, best, _LEVEL):  # or a better fit without it would but confirm that it may leave
                less = _better(less, self.fitted(less.terms))
                best = _better(best, self.polished(less, best.terms))  # as many attempts with the term as without it
            saved[name] = _saved(less, best)
            report(f"{name}: saves {100 * saved[name]:.0f} %")
            best = best if _worth(less, best, _LEVEL) else less
        return best

    def polished(self, before: _State, terms: tuple[str, ...]) -> _State:
        """The fits ``before`` with these terms, new ones faint at first, and some Gauss-Newton steps."""
        faint = encoded(FAINT | self._runs.preset.stated_constants, terms)
        rows = {name: row for row, name in enumerate(parameters_of(before.terms))}
        columns = [
            before.raw[:, rows[name]] if name in rows else np.full(len(before.raw), faint[row])
            for row, name in enumerate(parameters_of(terms))
        ]
        start = np.stack(columns, axis=1)
        center = np.median(start, axis=0)
        fit = MotorFit(with_motor(self._network, center, terms), self._runs, self._seen)
        held = held_constants(terms, self._runs)
        found = fit.polish(start - center, weak_belief(len(center)).holding(held), _STEPS)
        return self._state(terms, center, np.where(held, 0.0, found.z))

    def _state(self, terms: tuple[str, ...], center: np.ndarray, z: np.ndarray) -> _State:
        losses = MotorFit(with_motor(self._network, center, terms), self._runs).window_losses(z)
        raw = center + np.clip(z, -LOG_REACH, LOG_REACH)  # as the decoder has them
        held_out, groups = losses[:, self._unseen], self._parts[self._unseen]
        parts = np.stack([held_out[:, groups == group].mean(axis=1) for group in np.unique(groups)], axis=1)
        return _State(terms, raw, losses[:, self._seen].mean(axis=1), held_out.mean(axis=1), parts)


def _better(one: _State, other: _State) -> _State:
    """Of every motor the one that fits better what is fitted."""
    chosen = other.fitted < one.fitted
    names = ("raw", "fitted", "held_out", "parts")
    return _State(one.terms, *(of_either(chosen, getattr(one, name), getattr(other, name)) for name in names))


def stretches(runs: WindowRuns, least: int = FEWEST) -> np.ndarray:
    """(N,) number of the stretch that each window is in: its segment or, of fewer than least, one of STRETCHES parts.

    Presets have five excitations in turn: over two rounds of segments, every second one has each of them. Segments
    under different conditions (VARIES) stand in the order of these, so that every second stretch has about the
    conditions of its neighbour.
    """
    groups = runs.groups()
    if len(same_conditions(runs)) < len(VARIES):
        under = np.array([segment.conditions.mean(axis=1) for segment in runs.segments])
        groups = np.argsort(np.lexsort(under.round(2).T[::-1]))[groups]
    if groups.max() + 1 >= least:
        return groups
    parts, count = np.empty_like(groups), len(groups)
    parts[np.argsort(groups, kind="stable")] = np.arange(count) * min(STRETCHES, count) // count
    return parts


def held_out_windows(runs: WindowRuns) -> np.ndarray:
    """(N,) whether a window is judged, not fitted: every second of the `stretches`."""
    return stretches(runs) % 2 == 1


def segments_to_choose_by(motors: int) -> int:
    """Least number of segments that are the stretches by which terms of so many motors are chosen.

    Fewer are cut into STRETCHES: of fewer than _RANKS_TELL motors the test needs many gains of each.
    """
    return FEWEST if motors >= _RANKS_TELL else -(-STRETCHES // motors)
