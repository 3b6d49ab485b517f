"""Selection of optional dynamics terms (`optional_terms`) on held-out free runs, from the motor without any.

Some motors are fitted to every second segment of their logs, or every second part of a log of few
segments, and tested on the others. In each round, every term that is not yet selected is added to
two motors:

    the best so far     its constants are sampled around the initial motor's; the fit never becomes worse
    the simplest        it has a rigid gear, so other constants cannot hide the effect; the best starts its own search

The terms of SERVO are also added together, since some help only with another. Of the candidates
that lower the training loss most, the one that saves most of the held-out loss is selected if

    median over motors of log(loss with it / loss without) < log(1 - MIN_SAVING),   Wilcoxon's signed-rank test at 5 %

For fewer than five motors the test is over their held-out parts. The rounds end when no candidate
passes. Finally every selected term is removed once, and stays out if it does not pass this test at
20 %.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any, cast

import numpy as np

from motorprior.actuator.geared_motor_step import LOG_REACH, PARAMETERS, parameters_of
from motorprior.actuator.optional_terms import TERMS, constants_of, in_order
from motorprior.identification.physics.motor_fit import (
    STEPS,
    Checkpoint,
    MotorFits,
    fit_motors,
    fit_rigid_motors,
    unsaved,
)
from motorprior.identification.physics.motor_problem import (
    centred,
    fixed_constants,
    grey_box,
    initial_center,
    motor_search,
    rigid_motor,
    separate_prior,
    with_more_terms,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.search import WIDE, Fit, Steps

SELECTABLE_TERMS = tuple(TERMS)
MIN_SAVING = 0.04  # share of the held-out loss that a term must save
# size of the selection: motors, and rows of each, or more rows for MIN_WINDOWS windows
MAX_MOTORS = 8
MAX_ROWS = 10_000
MIN_WINDOWS = 40
SERVO = tuple(name for name, term in TERMS.items() if term.is_usual)
# logs with fewer segments are cut into NUM_PARTS parts: half of a few segments does not show every
# load and motion
MIN_SEGMENTS = 16
NUM_PARTS = 32
# terms that need logs under several conditions, in the order of `SegmentArrays.conditions`, and the
# minimum difference between two segments: a share of the nominal voltage, and [K]
MIN_VARIATION = {"supply": 0.03, "temperature": 10.0}
TERM_OF = {"supply_voltage": "supply", "motor_temperature": "temperature"}  # by operating condition
# signed-rank test: for removals, for additions
_LEVEL = 0.2
_STRICT_LEVEL = 0.05
_MIN_RANKS = 5  # fewer gains cannot be significant at these levels
_NUM_CANDIDATES = 96
_FINALISTS = 2
_RESTARTS = 6
_SIMPLE_RESTARTS = 2
_SCREEN = ((4, WIDE),)  # descents of all candidates; those of the finalists are STEPS


@dataclass(frozen=True)
class Selection:
    """Selected terms, and the share of the held-out loss that each tried term saved (negative: cost)."""

    terms: tuple[str, ...]
    saved: dict[str, float]


@dataclass(frozen=True)
class _State:
    """A fit of m motors."""

    terms: tuple[str, ...]
    raw: np.ndarray  # (m, K) decoder outputs
    fitted: np.ndarray  # (m,) training loss
    held_out: np.ndarray  # (m,)
    parts: np.ndarray  # (m, s) held-out loss by part


def select_terms(
    runs: WindowRuns,
    seed: int,
    report: Callable[[str], None] = lambda text: None,
    checkpoint: Checkpoint = unsaved,
) -> Selection:
    """Choose terms for the motors of ``runs``; MAX_MOTORS of a fleet are enough.

    ``report`` is called for every candidate in the first round, then for every selected or removed
    term. ``checkpoint`` saves every search.
    """
    motors = runs.num_motors
    # many gains of each
    parts = parts_of(runs, MIN_SEGMENTS if motors >= _MIN_RANKS else -(-NUM_PARTS // motors))
    given = runs.recipe.logged_terms
    off = (*runs.recipe.disabled_terms, *same_conditions(runs))
    test = parts % 2 == 1
    if test.all() or not test.any():  # too short a log
        return Selection(given, {})
    fits = _TermEvaluation(runs, parts, seed, checkpoint)
    rigid = fits.rigid(given)
    best = fits.with_all_constants(rigid)
    saved = {}
    groups = [(name,) for name in SELECTABLE_TERMS if name not in (*given, *off)]
    servo = tuple(name for name in SERVO if name not in (*given, *off))
    for round_number in range(len(SELECTABLE_TERMS)):
        left = [group for group in groups if group[0] not in best.terms]
        together = tuple(name for name in servo if name not in best.terms)
        left += [together] * (len(together) > 1)
        tried = {group: fits.with_terms(best, group) for group in left}
        for group, more in tried.items() if round_number == 0 else ():
            if len(group) == 1:
                report(f"{group[0]}: saves {100 * _saved(best, more):.0f} %")
        finalists = sorted(tried, key=lambda group: np.median(_logarithm(tried[group].fitted)))[
            :_FINALISTS
        ]
        polished = {
            group: fits.with_terms(tried[group], group, _RESTARTS, STEPS) for group in finalists
        }
        if left:
            simple = {group: fits.simplest_with(rigid, group) for group in left}
            first = min(simple, key=lambda group: np.median(_logarithm(simple[group].fitted)))
            other = fits.with_all_constants(simple[first])
            if first not in polished or other.fitted.mean() < polished[first].fitted.mean():
                polished[first] = other
        saved |= {
            group[0]: _saved(best, more)
            for group, more in (tried | polished).items()
            if len(group) == 1
        }
        passed = {
            group: more
            for group, more in polished.items()
            if _saves_enough(best, more, _STRICT_LEVEL)
        }
        if not passed:
            break
        chosen = max(passed, key=lambda group: _saved(best, passed[group]))
        best = passed[chosen]
        rigid = fits.simplest_with(rigid, chosen)
        report(f"selected {', '.join(best.terms)}")
    for name in [name for name in best.terms if name not in given]:
        less = fits.without(best, name)
        saved[name] = _saved(less, best)
        if not _saves_enough(less, best, _LEVEL):
            best = less
        report(f"{name}: saves {100 * saved[name]:.0f} %")
    return Selection(best.terms, saved)


def min_difference(condition: str, nominal: float) -> float:
    """Minimum difference between segments (MIN_VARIATION) in the unit of the condition, [V] or [°C]."""
    value = MIN_VARIATION[TERM_OF[condition]]
    return value * nominal if condition == "supply_voltage" else value


def same_conditions(runs: WindowRuns) -> tuple[str, ...]:
    """Terms of MIN_VARIATION whose condition is about the same in all segments, or was not logged."""
    ranges = np.ptp([segment.conditions for segment in runs.segments], axis=0).max(axis=1)
    return tuple(
        name
        for (name, limit), size in zip(MIN_VARIATION.items(), ranges, strict=True)
        if size < limit
    )


def _saved(before: _State, after: _State) -> float:
    return 1.0 - float(np.exp(np.median(_logarithm(after.held_out) - _logarithm(before.held_out))))


def _saves_enough(before: _State, after: _State, level: float) -> bool:
    """Whether the fits ``after`` save more than MIN_SAVING of the held-out loss, significantly at this ``level``."""
    from scipy.stats import wilcoxon  # here: it takes half a second to import

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


class _TermEvaluation:
    """Fits to the windows in every second of these ``parts`` (N,), tested on the others."""

    def __init__(self, runs: WindowRuns, parts: np.ndarray, seed: int, checkpoint: Checkpoint):
        self._runs = runs
        self._parts = parts
        self._seed = seed
        self._checkpoint = checkpoint
        self._searches = count()
        self._train = parts % 2 == 0
        self._test = parts % 2 == 1
        self._trained = runs.chosen(self._train)

    def rigid(self, terms: tuple[str, ...]) -> _State:
        """The simplest motors, with a rigid gear."""

        def raw() -> np.ndarray:
            # they would hide a limit of speed
            found = fit_rigid_motors(self._trained, terms, self._seed, limits=False)
            return found.center + found.offsets

        return self._state(terms, raw)

    def with_all_constants(self, rigid: _State) -> _State:
        """A search from simplest motors, with all constants."""
        center = rigid.raw.mean(axis=0)
        terms = rigid.terms
        nested = MotorFits(center, rigid.raw - center, rigid.fitted, terms, is_rigid=True)

        def raw() -> np.ndarray:
            found = fit_motors(
                self._trained, terms, False, self._seed, nested=nested, restarts=_RESTARTS
            )
            return found.center + found.offsets

        return self._state(terms, raw)

    def simplest_with(self, rigid: _State, added: tuple[str, ...]) -> _State:
        """The simplest motors with more terms."""
        terms = in_order((*rigid.terms, *added))
        _, missing = rigid_motor(initial_center(terms, self._runs), terms, self._runs)
        fixed = missing & np.isin(parameters_of(terms), PARAMETERS)
        return self._searched(rigid, terms, added, _SIMPLE_RESTARTS, _SCREEN, fixed)

    def with_terms(
        self, before: _State, added: tuple[str, ...], restarts: int = 0, steps: Steps = _SCREEN
    ) -> _State:
        """The fits ``before`` with more terms, after a search."""
        return self._searched(before, in_order((*before.terms, *added)), added, restarts, steps)

    def without(self, before: _State, name: str) -> _State:
        """The fits ``before`` without a term, after a longer search."""
        return self._searched(
            before, tuple(other for other in before.terms if other != name), (), 0, STEPS
        )

    def _searched(
        self,
        before: _State,
        terms: tuple[str, ...],
        added: tuple[str, ...],
        restarts: int,
        steps: Steps,
        fixed: np.ndarray | bool = False,
    ) -> _State:
        """Descents from ``before``, with ``added`` terms' constants sampled around the initial motor's, half of others.

        Constants that are ``fixed`` (K,) do not change.
        """
        rng = np.random.default_rng([self._seed, *map(list(TERMS).index, terms)])
        raw = with_more_terms(before.raw, before.terms, terms, self._runs)
        fixed = fixed | fixed_constants(terms, self._runs)
        center = np.where(fixed, raw[0], 0.5 * (raw.min(axis=0) + raw.max(axis=0)))
        initial = initial_center(terms, self._runs) - center
        is_new = np.isin(parameters_of(terms), constants_of(added))
        search = centred(center, terms, self._trained)

        def draw(restart: int, best: Fit) -> np.ndarray:
            shape = (len(raw), _NUM_CANDIDATES, len(center))
            others = (rng.random(shape) < 0.5) & (np.arange(_NUM_CANDIDATES)[:, None] % 2 == 1)
            drawn = np.where(is_new, rng.random(shape) < 0.7, others)
            candidates = np.where(
                drawn, initial + 0.8 * rng.standard_normal(shape), best.x[:, None]
            )
            candidates[:, 0] = best.x
            return np.clip(np.where(fixed, 0.0, candidates), -LOG_REACH, LOG_REACH)

        x = np.clip(raw - center, -LOG_REACH, LOG_REACH)
        prior = separate_prior(search, x, np.zeros(len(center)), initial).fixing(fixed)

        def fitted() -> np.ndarray:
            found = search.at(x, prior)
            if added:
                found = search.at(search.best_of(draw(0, found), prior), prior)
            found = search.until_found_again(
                search.descend(found.x, prior, steps), prior, draw, restarts, steps
            )
            return center + np.where(fixed, 0.0, np.clip(found.x, -LOG_REACH, LOG_REACH))

        return self._state(terms, fitted)

    def _state(self, terms: tuple[str, ...], fitted: Callable[[], np.ndarray]) -> _State:
        """The fit with decoder outputs ``fitted``, which an interrupted run may have saved."""
        raw = self._checkpoint(f"search_{next(self._searches)}", lambda: {"raw": fitted()})["raw"]
        center = 0.5 * (raw.min(axis=0) + raw.max(axis=0))
        losses = motor_search(grey_box(center, terms, self._runs.recipe), self._runs).parts(
            raw - center
        )
        held_out = losses[:, self._test]
        groups = self._parts[self._test]
        parts = np.stack(
            [held_out[:, groups == group].mean(axis=1) for group in np.unique(groups)], axis=1
        )
        return _State(terms, raw, losses[:, self._train].mean(axis=1), held_out.mean(axis=1), parts)


def parts_of(runs: WindowRuns, min_segments: int = MIN_SEGMENTS) -> np.ndarray:
    """(N,) index of the part of each window: its segment or, for fewer segments, one of NUM_PARTS parts.

    Segments under different conditions (MIN_VARIATION) are sorted by these, so that neighbouring
    parts have similar conditions.
    """
    groups = runs.groups()
    if len(same_conditions(runs)) < len(MIN_VARIATION):
        conditions = np.array([segment.conditions.mean(axis=1) for segment in runs.segments])
        groups = np.argsort(np.lexsort(conditions.round(2).T[::-1]))[groups]
    if groups.max() + 1 >= min_segments:
        return groups
    parts = np.empty_like(groups)
    count = len(groups)
    parts[np.argsort(groups, kind="stable")] = np.arange(count) * min(NUM_PARTS, count) // count
    return parts
