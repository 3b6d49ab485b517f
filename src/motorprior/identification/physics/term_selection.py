"""Selection of optional dynamics terms (`optional_terms`) by backward elimination on held-out free runs.

Some motors are fitted to every second segment of their logs and tested on the others. First, all terms are fitted
together, since some help only with another: by several searches, and by one that starts from the terms of SERVO alone.
Each motor keeps its best fit. Then each term is removed in turn, the rarest first. The fit is polished without it and,
if the loss rises, searched again, since a term changes other constants. The term stays if

    median over motors of log(loss with it / loss without) < log(1 - MIN_SAVING),   Wilcoxon's signed-rank test at 20 %

(at 5 %, few motors lose terms that they have; for fewer than five motors the test is over their held-out parts).
Rounds with the terms that saved at most CLEAR_SAVING follow until no term is removed. Each removed term is then added
once more and stays if it saves MIN_SAVING, significantly at 5 %. Finally all terms are compared with none in the same
way. Where conditions differ between segments, their terms are also tried alone: with few logs, a fit of all terms may
be too poor to identify them. Terms with logged constants, and conditions that do not vary, are not tried.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.stats import wilcoxon

from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.optional_terms import ELIMINATION_ORDER, NEGLIGIBLE, TERMS, in_order
from motorprior.identification.physics.fleet_fit import TURNS, fit_fleet, fixed_constants, weak_prior
from motorprior.identification.physics.initial_motor import encoded, with_motor
from motorprior.identification.physics.motor_fit import MotorFit, select
from motorprior.identification.physics.window_runs import WindowRuns

MIN_SAVING = 0.04  # share of the held-out loss that a term must save
CLEAR_SAVING = 0.3  # share of the held-out loss: a term that saved more in one round is not removed in the next
# of the selection: motors, and rows of each, or more rows for MIN_WINDOWS windows
MAX_MOTORS, MAX_ROWS, MIN_WINDOWS = 8, 10_000, 60
SERVO = tuple(name for name, term in TERMS.items() if term.is_usual)
MIN_SEGMENTS, NUM_PARTS = 4, 32  # logs with fewer segments are cut into NUM_PARTS parts
# terms that need logs under several conditions, in the order of `Segment.conditions`, and the minimum difference
# between two segments: a share of the nominal voltage, and [K]
MIN_VARIATION = {"supply": 0.03, "temperature": 10.0}
TERM_OF = {"supply_voltage": "supply", "motor_temperature": "temperature"}  # by channel of `motor_log.CONDITIONS`
_LEVEL, _STRICT_LEVEL = 0.2, 0.05  # of the signed-rank test, for elimination and for additions
_MIN_RANKS = 5  # fewer gains cannot be significant at these levels
_ATTEMPTS, _STEPS, _TURNS = 3, 10, (*TURNS[:3], *TURNS[-2:])


@dataclass(frozen=True)
class Selection:
    """Selected terms, and the share of the held-out loss that each tried term saved (negative: cost)."""

    terms: tuple[str, ...]
    saved: dict[str, float]


@dataclass(frozen=True)
class _State:
    """A fit of m motors."""

    terms: tuple[str, ...]
    raw: np.ndarray  # (m, P) decoder outputs
    fitted: np.ndarray  # (m,) training loss
    held_out: np.ndarray  # (m,)
    parts: np.ndarray  # (m, s) held-out loss by part


def select_terms(
    network: LatentNetwork, runs: WindowRuns, seed: int, report: Callable[[str], None] = lambda text: None
) -> Selection:
    """Choose terms for the motors of ``runs``; MAX_MOTORS of a fleet are enough.

    ``report`` is called for every term of ELIMINATION_ORDER in the first round, then for every fit of a later round.
    """
    motors = runs.num_motors
    parts = parts_of(runs, MIN_SEGMENTS if motors >= _MIN_RANKS else -(-NUM_PARTS // motors))  # many gains of each
    given, off = runs.preset.logged_terms, (*runs.preset.disabled_terms, *same_conditions(runs))
    tried = tuple(name for name in ELIMINATION_ORDER if name not in off)
    test = parts % 2 == 1
    if test.all() or not test.any():  # too short a log
        return Selection(given, {})
    search = _Search(network, runs, parts, seed, report)
    best = search.all_terms(tried, (*(name for name in SERVO if name not in off), *given))
    for name in ELIMINATION_ORDER:
        if name in (*given, *off):
            report(f"{name}: {'logged' if name in given else 'not tried'}")
    best, saved = search.eliminated(best)
    if varied := tuple(name for name in MIN_VARIATION if name not in off):
        alone, saved_alone = search.eliminated(search.fitted((*varied, *given)))
        if _saves_enough(best, alone, _STRICT_LEVEL):
            best, saved = alone, saved_alone
    if best.terms != given:
        bare = _better(search.polished(best, given), search.fitted(given))
        best = best if _saves_enough(bare, best, _STRICT_LEVEL) else bare
    return Selection(best.terms, saved)


def min_difference(condition: str, nominal: float) -> float:
    """Minimum difference between segments (MIN_VARIATION) in the unit of the condition, [V] or [°C]."""
    value = MIN_VARIATION[TERM_OF[condition]]
    return value * nominal if condition == "supply_voltage" else value


def same_conditions(runs: WindowRuns) -> tuple[str, ...]:
    """Terms of MIN_VARIATION whose condition is about the same in all segments, or was not logged."""
    ranges = np.ptp([segment.conditions for segment in runs.segments], axis=0).max(axis=1)
    return tuple(name for (name, limit), size in zip(MIN_VARIATION.items(), ranges, strict=True) if size < limit)


def _saved(before: _State, after: _State) -> float:
    return 1.0 - float(np.exp(np.median(_logarithm(after.held_out) - _logarithm(before.held_out))))


def _saves_enough(before: _State, after: _State, level: float) -> bool:
    """Whether the fits ``after`` save more than MIN_SAVING of the held-out loss, significantly at this ``level``.

    The signed-rank test is over the gains of all motors or, for fewer than _MIN_RANKS motors, over their parts.
    """
    if len(before.held_out) >= _MIN_RANKS:
        gains = _logarithm(before.held_out) - _logarithm(after.held_out)
    else:
        gains = (_logarithm(before.parts) - _logarithm(after.parts)).ravel()
    if len(gains) < _MIN_RANKS or not gains.any():
        return False
    pvalue = float(cast(Any, wilcoxon(gains, alternative="greater")).pvalue)
    return _saved(before, after) > MIN_SAVING and pvalue < level


def _logarithm(loss: np.ndarray) -> np.ndarray:
    return np.log(loss + 1e-9)  # the loss of a static part may be 0


class _Search:
    """Fits to the windows in every second of these ``parts`` (N,), tested on the others; logged terms stay."""

    def __init__(
        self, network: LatentNetwork, runs: WindowRuns, parts: np.ndarray, seed: int, report: Callable[[str], None]
    ):
        self._network, self._runs, self._parts, self._seed, self._report = network, runs, parts, seed, report
        self._train, self._test, self._given = parts % 2 == 0, parts % 2 == 1, runs.preset.logged_terms

    def fitted(self, terms: tuple[str, ...], attempt: int = 0) -> _State:
        """A new search."""
        terms, seed = in_order(terms), self._seed + attempt
        found = fit_fleet(self._network, self._runs, terms, True, seed, chosen=self._train, turns=_TURNS)
        return self._state(terms, found.center, found.offsets)

    def all_terms(self, tried: tuple[str, ...], servo: tuple[str, ...]) -> _State:
        """The best of several fits of all terms for every motor; one starts from those of a ``servo`` alone."""
        best = self.polished(self.fitted(servo), in_order(tried))
        for attempt in range(_ATTEMPTS):
            best = _better(best, self.fitted(tried, attempt))
        return best

    def eliminated(self, best: _State) -> tuple[_State, dict[str, float]]:
        """The fit after rounds of elimination, and the share that each tried term saved."""
        before, tried, saved = (), best.terms, {}
        while best.terms != before:
            before = best.terms
            best = self._one_round(best, saved)
        # each removed term is tried once more, the most common first
        same = self.polished(best, best.terms)
        for name in [name for name in reversed(ELIMINATION_ORDER) if name in tried and name not in best.terms]:
            more = self.polished(best, in_order((*best.terms, name)))
            if _saves_enough(same, more, _STRICT_LEVEL):
                best, saved[name] = more, _saved(same, more)
                same = self.polished(best, best.terms)
                self._report(f"{name}: retried, saves {100 * saved[name]:.0f} %")
        return best, saved

    def _one_round(self, best: _State, saved: dict[str, float]) -> _State:
        """Remove each term that was not logged in turn; ``saved`` receives the share that each saves."""
        for name in [name for name in ELIMINATION_ORDER if name in best.terms and name not in self._given]:
            if saved.get(name, 0.0) > CLEAR_SAVING:
                continue
            less = self.polished(best, tuple(other for other in best.terms if other != name))
            if _saves_enough(less, best, _LEVEL):  # otherwise a better fit without it changes nothing
                less = _better(less, self.fitted(less.terms))
                best = _better(best, self.polished(less, best.terms))  # as many attempts with the term as without it
            saved[name] = _saved(less, best)
            self._report(f"{name}: saves {100 * saved[name]:.0f} %")
            best = best if _saves_enough(less, best, _LEVEL) else less
        return best

    def polished(self, before: _State, terms: tuple[str, ...]) -> _State:
        """The fits ``before`` with these terms after some Gauss-Newton steps; new terms start negligible."""
        weak = encoded(NEGLIGIBLE | self._runs.preset.logged_values, terms)
        start = np.tile(weak, (len(before.raw), 1))
        for row, name in enumerate(parameters_of(before.terms)):
            if name in parameters_of(terms):
                start[:, parameters_of(terms).index(name)] = before.raw[:, row]
        center = np.median(start, axis=0)
        fit = MotorFit(with_motor(self._network, center, terms), self._runs, self._train)
        fixed = fixed_constants(terms, self._runs)
        found = fit.polish(start - center, weak_prior(len(center)).fixing(fixed), _STEPS)
        return self._state(terms, center, np.where(fixed, 0.0, found.z))

    def _state(self, terms: tuple[str, ...], center: np.ndarray, z: np.ndarray) -> _State:
        losses = MotorFit(with_motor(self._network, center, terms), self._runs).window_losses(z)
        raw = center + np.clip(z, -LOG_REACH, LOG_REACH)  # as the decoder has them
        held_out, groups = losses[:, self._test], self._parts[self._test]
        parts = np.stack([held_out[:, groups == group].mean(axis=1) for group in np.unique(groups)], axis=1)
        return _State(terms, raw, losses[:, self._train].mean(axis=1), held_out.mean(axis=1), parts)


def _better(one: _State, other: _State) -> _State:
    """The fit with less training loss, for every motor."""
    chosen, names = other.fitted < one.fitted, ("raw", "fitted", "held_out", "parts")
    return _State(one.terms, *(select(chosen, getattr(other, name), getattr(one, name)) for name in names))


def parts_of(runs: WindowRuns, min_segments: int = MIN_SEGMENTS) -> np.ndarray:
    """(N,) index of the part of each window: its segment or, for fewer segments, one of NUM_PARTS parts.

    Segments under different conditions (MIN_VARIATION) are sorted by these, so that neighbouring parts have similar
    conditions.
    """
    groups = runs.groups()
    if len(same_conditions(runs)) < len(MIN_VARIATION):
        conditions = np.array([segment.conditions.mean(axis=1) for segment in runs.segments])
        groups = np.argsort(np.lexsort(conditions.round(2).T[::-1]))[groups]
    if groups.max() + 1 >= min_segments:
        return groups
    parts, count = np.empty_like(groups), len(groups)
    parts[np.argsort(groups, kind="stable")] = np.arange(count) * min(NUM_PARTS, count) // count
    return parts


def held_out_windows(runs: WindowRuns) -> np.ndarray:
    """(N,) whether a window is for testing: every second of the `parts_of`."""
    return parts_of(runs) % 2 == 1
