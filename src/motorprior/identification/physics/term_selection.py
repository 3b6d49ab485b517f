"""Selection of optional dynamics terms (`optional_terms`) on held-out free runs.

Some motors are fitted to every second segment of their logs, or every second block of a log of few
segments, and tested on the others. They start without any optional term. In each round, every term
that is not yet selected is added to two motors:

    best motor so far   the constants of the term are sampled around the initial motor's; the fit
                        never becomes worse
    simplest motor      its gear is rigid, so other constants cannot hide the effect of the term; a
                        further search starts from the best of the simplest motors

The usual terms of servos are also added together, since some terms help only with another term. Of
the candidates that lower the training loss most, the candidate that saves most of the held-out loss
is selected if

    median over motors of log(loss with it / loss without) < log(1 - MIN_SAVING)
    Wilcoxon's signed-rank test of these logarithms is significant at 5 %

For fewer than five motors the test is over their held-out blocks. The rounds end when no candidate
passes. Finally every selected term is removed once, and stays out if it does not pass this test at
20 %.

Limits of speed, acceleration and torque come first, in rounds of their own: another term could
stand in for them. They act in few windows, so only the held-out windows in which they bind count.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, TypeAlias, cast

import numpy as np

from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, PARAMETERS, parameters_of
from motorprior.actuator.optional_terms import TERMS, constants_of, in_order
from motorprior.identification.checkpoint import Checkpoint, PartCheckpoint, parts_of, unsaved
from motorprior.identification.physics.descents import STEPS, reachable
from motorprior.identification.physics.limits import binding_windows
from motorprior.identification.physics.motor_fit import MotorFits, fit_motors, fit_rigid_motors
from motorprior.identification.physics.motor_problem import (
    centred_search,
    fixed_constants,
    grey_box,
    initial_center,
    motor_search,
    rigid_motor,
    single_motor_prior,
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
# logs with fewer segments are cut into NUM_BLOCKS blocks: half of a few segments does not contain
# every load and motion
MIN_SEGMENTS = 16
NUM_BLOCKS = 32
# terms that need logs under several operating conditions, in the order of
# `SegmentArrays.operating_conditions`, and the minimum difference between two segments: a share of
# the nominal voltage, and [K]
MIN_VARIATION = {"supply": 0.03, "temperature": 10.0}
TERM_OF = {"supply_voltage": "supply", "motor_temperature": "temperature"}  # by operating condition
# levels of the signed-rank test
_REMOVAL_LEVEL = 0.2
_ADDITION_LEVEL = 0.05
_MIN_RANKS = 5  # fewer savings cannot be significant at these levels
_NUM_CANDIDATES = 96
_FINALISTS = 2
_RESTARTS = 6
_SIMPLE_RESTARTS = 2
_SCREEN = ((4, WIDE),)  # descents of all candidates; finalists descend by STEPS

Group: TypeAlias = tuple[str, ...]
"""Terms that are added together: one, or the usual terms of servos."""


@dataclass(frozen=True)
class Selection:
    """Selected terms, and the share of the held-out loss that each tried term saved."""

    terms: tuple[str, ...]
    saved: dict[str, float]  # negative: the term costs


@dataclass(frozen=True)
class _EvaluatedFit:
    """A fit of m motors with some terms, and its losses."""

    terms: tuple[str, ...]
    outputs: np.ndarray  # (m, K) decoder outputs
    train: np.ndarray  # (m,) training loss
    held_out: np.ndarray  # (m, n) losses of the held-out windows
    blocks: np.ndarray  # (n,) blocks of these windows
    classes: np.ndarray  # (m,) class of the joint of each motor
    binding: dict[str, np.ndarray]  # (m, n) windows in which a limit binds, by term


def select_terms(
    runs: WindowRuns,
    seed: int,
    report: Callable[[str], None] = lambda text: None,
    checkpoint: Checkpoint = unsaved,
    selectable: Sequence[str] = SELECTABLE_TERMS,
) -> Selection:
    """Select terms for the motors of ``runs``; MAX_MOTORS of a fleet are enough.

    Args:
        runs: free runs over the logs of the motors.
        seed: of the searches.
        report: called for every candidate in the first round, then for every selected or removed
            term.
        checkpoint: saves every search.
        selectable: terms that are tried; logged terms are always selected.
    """
    # for few motors, more blocks are needed to test the savings
    few_motors = runs.num_motors < _MIN_RANKS
    min_segments = -(-NUM_BLOCKS // runs.num_motors) if few_motors else MIN_SEGMENTS
    blocks = blocks_of(runs, min_segments)
    logged = runs.recipe.logged_terms
    is_test = blocks % 2 == 1
    if is_test.all() or not is_test.any():  # too short a log
        return Selection(logged, {})

    unavailable = {*logged, *runs.recipe.disabled_terms, *terms_without_variation(runs)}
    candidates = [name for name in selectable if name not in unavailable]
    fits = _TermFits(runs, blocks, seed, checkpoint)
    saved: dict[str, float] = {}
    limits = [name for name in candidates if TERMS[name].is_limit]
    others = [name for name in candidates if name not in limits]
    rigid = fits.rigid(logged)
    best = fits.with_all_constants(rigid)
    for names in (limits, others):
        best, rigid = _with_useful_terms(fits, best, rigid, names, saved, report)
    best = _without_useless_terms(fits, best, logged, saved, report)
    return Selection(best.terms, saved)


def some_motors(joint_classes: Sequence[str], num_motors: int) -> np.ndarray:
    """Indices of at most MAX_MOTORS motors, equally many of each class of joints."""
    classes = np.unique(joint_classes or [""] * num_motors, return_inverse=True)[1]
    of_classes = [np.flatnonzero(classes == number) for number in range(classes.max() + 1)]
    quota = max(1, MAX_MOTORS // len(of_classes))
    chosen = np.sort(np.concatenate([_spread(motors, quota) for motors in of_classes]))
    return _spread(chosen, MAX_MOTORS)


def _spread(motors: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` of the motors, evenly spread."""
    places = np.linspace(0, len(motors) - 1, min(count, len(motors)))
    return motors[places.astype(int)]


def _with_useful_terms(
    fits: "_TermFits",
    best: _EvaluatedFit,
    rigid: _EvaluatedFit,
    candidates: Sequence[str],
    saved: dict[str, float],
    report: Callable[[str], None],
) -> tuple[_EvaluatedFit, _EvaluatedFit]:
    """The best fit and the simplest motors after rounds that add terms among ``candidates``.

    The share of the held-out loss that a term saves is added to ``saved``.
    """
    for round_number in range(len(candidates)):
        groups = _groups(candidates, best.terms)
        screened = {group: fits.with_terms(best, group) for group in groups}
        if round_number == 0:
            for (name, *more), fit in screened.items():
                if not more:
                    report(_saving_text(name, _saved(best, fit, (name,))))

        simplest = {group: fits.simplest_with(rigid, group) for group in groups}
        finalists = _finalists(fits, screened, simplest)
        for (name, *more), fit in (screened | finalists).items():
            if not more:
                saved[name] = _saved(best, fit, (name,))

        savings = {}
        for group, fit in finalists.items():
            if _saves_enough(best, fit, group, _ADDITION_LEVEL):
                savings[group] = _saved(best, fit, group)
        if not savings:
            break

        winner = max(savings, key=lambda group: savings[group])
        best = finalists[winner]
        rigid = simplest[winner]
        report(f"selected {', '.join(best.terms)}")
    return best, rigid


def _without_useless_terms(
    fits: "_TermFits",
    best: _EvaluatedFit,
    logged: tuple[str, ...],
    saved: dict[str, float],
    report: Callable[[str], None],
) -> _EvaluatedFit:
    """The best fit without terms that are of no use beside terms that were selected later."""
    for name in best.terms:
        if name in logged:
            continue
        without = fits.without(best, name)
        saved[name] = _saved(without, best, (name,))
        if not _saves_enough(without, best, (name,), _REMOVAL_LEVEL):
            best = without
        report(_saving_text(name, saved[name]))
    return best


def _saving_text(name: str, share: float) -> str:
    """A line of progress on the share of the held-out loss that a term saves."""
    return f"{name}: saves {100 * share:.0f} %" if share > 0.0 else f"{name}: saves nothing"


def _groups(candidates: Sequence[str], selected: tuple[str, ...]) -> list[Group]:
    """Groups of terms that a round adds to the ``selected`` terms."""
    remaining = [name for name in candidates if name not in selected]
    groups: list[Group] = [(name,) for name in remaining]
    servo_terms = tuple(name for name in TERMS if name in remaining and TERMS[name].is_usual)
    if len(servo_terms) > 1:
        groups.append(servo_terms)
    return groups


def _finalists(
    fits: "_TermFits",
    screened: dict[Group, _EvaluatedFit],
    simplest: dict[Group, _EvaluatedFit],
) -> dict[Group, _EvaluatedFit]:
    """Thorough fits of the groups that lower the training loss most.

    Two groups are chosen by the ``screened`` fits of the best motor with each group, and one by the
    ``simplest`` motors with each group.
    """

    def median_loss(fit: _EvaluatedFit) -> np.floating:
        return np.median(_logarithm(fit.train))

    groups = sorted(screened, key=lambda group: median_loss(screened[group]))[:_FINALISTS]
    simplest_group = min(simplest, key=lambda group: median_loss(simplest[group]), default=None)
    if simplest_group is not None and simplest_group not in groups:
        groups.append(simplest_group)

    # either start can lead to a local optimum, so a finalist is searched from both
    finalists = {}
    for group in groups:
        fit = fits.with_terms(screened[group], group, _RESTARTS, STEPS)
        if group in simplest:
            from_simplest = fits.with_all_constants(simplest[group])
            fit = min(fit, from_simplest, key=lambda fit: fit.train.mean())
        finalists[group] = fit
    return finalists


def min_condition_difference(name: str, nominal: float) -> float:
    """Minimum difference between segments of an operating condition, [V] or [°C].

    MIN_VARIATION in these units; ``name`` is the channel, and ``nominal`` its nominal value.
    """
    variation = MIN_VARIATION[TERM_OF[name]]
    return variation * nominal if name == "supply_voltage" else variation


def terms_without_variation(runs: WindowRuns) -> tuple[str, ...]:
    """Terms of MIN_VARIATION that the logs do not identify.

    Their operating condition is about the same in all segments, or was not logged.
    """
    by_segment = [segment.operating_conditions for segment in runs.segments]
    ranges = np.ptp(by_segment, axis=0).max(axis=1)  # maximum over the motors
    steady = []
    for (name, minimum), value_range in zip(MIN_VARIATION.items(), ranges, strict=True):
        if value_range < minimum:
            steady.append(name)
    return tuple(steady)


def _saved(without: _EvaluatedFit, fit: _EvaluatedFit, added: Group) -> float:
    """Share of the held-out loss that a fit with ``added`` terms saves, median over the motors.

    The largest share of a group, see `_groups_of_motors`.
    """
    shares = []
    for motors in _groups_of_motors(fit, added):
        by_motor, _ = _savings(without, fit, added, motors)
        shares.append(_median_share(by_motor))
    return max(shares)


def _groups_of_motors(fit: _EvaluatedFit, added: Group) -> list[np.ndarray]:
    """Masks (m,) of the motors that are tested together: all, or those of each class of joints.

    By class for terms of the mechanism of a joint.
    """
    if not all(TERMS[name].is_of_joint for name in added):
        return [np.ones(len(fit.classes), bool)]
    return [fit.classes == joint_class for joint_class in np.unique(fit.classes)]


def _median_share(by_motor: np.ndarray) -> float:
    """Share of the loss that is saved, median over logarithms of ratios; 0 without any."""
    return 1.0 - float(np.exp(-np.median(by_motor))) if len(by_motor) else 0.0


def _saves_enough(without: _EvaluatedFit, fit: _EvaluatedFit, added: Group, level: float) -> bool:
    """Whether ``added`` terms save more than MIN_SAVING, significantly at ``level``.

    One of the `_groups_of_motors` is enough; the level is divided by their number (Bonferroni).
    """
    from scipy.stats import wilcoxon  # here: it takes half a second to import

    groups = _groups_of_motors(fit, added)
    for motors in groups:
        by_motor, by_block = _savings(without, fit, added, motors)
        savings = by_motor if len(by_motor) >= _MIN_RANKS else by_block
        if len(savings) < _MIN_RANKS or not savings.any():
            continue
        p_value = float(cast(Any, wilcoxon(savings, alternative="greater")).pvalue)
        if _median_share(by_motor) > MIN_SAVING and p_value < level / len(groups):
            return True
    return False


def _savings(
    without: _EvaluatedFit, fit: _EvaluatedFit, added: Group, motors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Logarithms of held-out losses without over with ``added`` terms, by motor and by block.

    ``motors`` (m,) is the mask of the motors that count. The losses are of the windows in which an
    added limit binds, otherwise of all windows. Motors and blocks without such windows are left
    out.
    """
    counts = np.ones(fit.held_out.shape, bool)
    if all(TERMS[name].is_limit for name in added):
        counts = np.any([fit.binding[name] for name in added], axis=0)
    counts = counts & motors[:, None]

    by_block = []
    for block in np.unique(fit.blocks):
        by_block.append(_log_ratios(without, fit, counts & (fit.blocks == block)))
    return _log_ratios(without, fit, counts), np.concatenate(by_block)


def _log_ratios(without: _EvaluatedFit, fit: _EvaluatedFit, counts: np.ndarray) -> np.ndarray:
    """Logarithms of the ratios of two fits' mean losses, of motors with windows that ``counts``."""
    ratios = []
    for motor in np.flatnonzero(counts.any(axis=1)):
        loss_without = without.held_out[motor, counts[motor]].mean()
        loss_with = fit.held_out[motor, counts[motor]].mean()
        ratios.append(_logarithm(loss_without) - _logarithm(loss_with))
    return np.array(ratios)


def _logarithm(loss: np.ndarray) -> np.ndarray:
    return np.log(loss + 1e-9)  # the loss of a static block may be 0


class _TermFits:
    """Fits to the windows in every second one of the ``blocks`` (N,), tested on the others."""

    def __init__(self, runs: WindowRuns, blocks: np.ndarray, seed: int, checkpoint: Checkpoint):
        self._runs = runs
        self._blocks = blocks
        self._seed = seed
        self._checkpoint = checkpoint
        self._fit_numbers = count()
        self._is_train = blocks % 2 == 0
        self._is_test = blocks % 2 == 1
        self._train_runs = runs.counting(self._is_train)

    def rigid(self, terms: tuple[str, ...]) -> _EvaluatedFit:
        """The simplest motors, with a rigid gear."""

        def fit(parts: PartCheckpoint) -> np.ndarray:
            # without a torque limit, which would hide a limit of speed
            return fit_rigid_motors(
                self._train_runs, terms, self._seed, limits=False, checkpoint=parts
            ).outputs

        return self._evaluated(terms, fit)

    def with_all_constants(self, rigid: _EvaluatedFit) -> _EvaluatedFit:
        """A search with all constants, from simplest motors."""
        center = rigid.outputs.mean(axis=0)
        offsets = rigid.outputs - center
        nested = MotorFits(center, offsets, rigid.train, rigid.terms, is_rigid=True)

        def fit(parts: PartCheckpoint) -> np.ndarray:
            return fit_motors(
                self._train_runs,
                rigid.terms,
                together=False,
                seed=self._seed,
                nested=nested,
                restarts=_RESTARTS,
                checkpoint=parts,
            ).outputs

        return self._evaluated(rigid.terms, fit)

    def simplest_with(self, rigid: _EvaluatedFit, added: Group) -> _EvaluatedFit:
        """The simplest motors with more terms."""
        terms = in_order((*rigid.terms, *added))
        _, missing = rigid_motor(initial_center(terms, self._runs), terms, self._runs)
        keep_rigid = missing & np.isin(parameters_of(terms), PARAMETERS)
        return self._searched(rigid, terms, added, _SIMPLE_RESTARTS, _SCREEN, keep_rigid)

    def with_terms(
        self, fit: _EvaluatedFit, added: Group, restarts: int = 0, steps: Steps = _SCREEN
    ) -> _EvaluatedFit:
        """The ``fit`` with more terms, after a search."""
        return self._searched(fit, in_order((*fit.terms, *added)), added, restarts, steps)

    def without(self, fit: _EvaluatedFit, name: str) -> _EvaluatedFit:
        """The ``fit`` without a term, after a longer descent."""
        terms = tuple(term for term in fit.terms if term != name)
        return self._searched(fit, terms, (), 0, STEPS)

    def _searched(
        self,
        start: _EvaluatedFit,
        terms: tuple[str, ...],
        added: Group,
        restarts: int,
        steps: Steps,
        frozen: np.ndarray | bool = False,
    ) -> _EvaluatedFit:
        """Descents from the fit ``start``, with candidates for the constants of ``added`` terms.

        These constants are sampled around the initial motor's; in every second candidate, a random
        half of the other constants is sampled as well. ``frozen`` (K,) constants do not change.
        """
        rng = np.random.default_rng([self._seed, *map(list(TERMS).index, terms)])
        fixed = frozen | fixed_constants(terms, self._runs)

        # around the middle of the motors
        outputs = with_more_terms(start.outputs, start.terms, terms, self._runs)
        middle = 0.5 * (outputs.min(axis=0) + outputs.max(axis=0))
        center = np.where(fixed, outputs[0], middle)
        initial = initial_center(terms, self._runs) - center
        is_new = np.isin(parameters_of(terms), constants_of(added))
        search = centred_search(center, terms, self._train_runs)

        def draw(restart: int, best: Fit) -> np.ndarray:
            shape = (len(outputs), _NUM_CANDIDATES, len(center))
            is_odd = np.arange(_NUM_CANDIDATES)[:, None] % 2 == 1
            samples_others = (rng.random(shape) < 0.5) & is_odd
            sampled = np.where(is_new, rng.random(shape) < 0.7, samples_others)
            samples = initial + 0.8 * rng.standard_normal(shape)
            candidates = np.where(sampled, samples, best.x[:, None])
            candidates[:, 0] = best.x
            return reachable(candidates, fixed)

        x = np.clip(outputs - center, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
        prior = single_motor_prior(search, x, np.zeros(len(center)), initial).fixing(fixed)

        def fit_outputs(parts: PartCheckpoint) -> np.ndarray:
            search = centred_search(center, terms, self._train_runs, parts)
            fit = search.at(x, prior)
            if added:
                fit = search.at(search.best_of(draw(0, fit), prior), prior)
            fit = search.descend(fit.x, prior, steps)
            fit = search.until_found_again(fit, prior, draw, restarts, steps)
            return center + np.where(fixed, 0.0, np.clip(fit.x, -MAX_LOG_FACTOR, MAX_LOG_FACTOR))

        return self._evaluated(terms, fit_outputs)

    def _evaluated(
        self, terms: tuple[str, ...], fit_outputs: Callable[[PartCheckpoint], np.ndarray]
    ) -> _EvaluatedFit:
        """Losses of the decoder outputs (m, K) that ``fit_outputs`` gives, or that were saved."""
        name = f"term_fit_{next(self._fit_numbers)}"
        parts = parts_of(name, self._checkpoint)
        outputs = self._checkpoint(name, lambda: {"outputs": fit_outputs(parts)})["outputs"]
        center = 0.5 * (outputs.min(axis=0) + outputs.max(axis=0))
        search = motor_search(grey_box(center, terms, self._runs.recipe), self._runs)
        losses = search.observation_losses(outputs - center)  # (m, N)

        binding = {}
        for term in terms:
            if TERMS[term].is_limit:
                binds = binding_windows(self._runs, outputs, terms, (term,))
                binding[term] = binds[:, self._is_test]
        return _EvaluatedFit(
            terms=terms,
            outputs=outputs,
            train=losses[:, self._is_train].mean(axis=1),
            held_out=losses[:, self._is_test],
            blocks=self._blocks[self._is_test],
            classes=self._runs.classes,
            binding=binding,
        )


def blocks_of(runs: WindowRuns, min_segments: int = MIN_SEGMENTS) -> np.ndarray:
    """(N,) index of the block of each window; odd blocks are held out.

    A block is a segment or, for fewer than ``min_segments``, one of NUM_BLOCKS. If the segments
    have several gains, every second gain is held out: a term must help at gains that it was not
    fitted to. Segments under different operating conditions (MIN_VARIATION) are sorted by these, so
    that neighbouring blocks have similar operating conditions.
    """
    segments = runs.segment_indices()
    if len(terms_without_variation(runs)) < len(MIN_VARIATION):
        means = [segment.operating_conditions.mean(axis=1) for segment in runs.segments]
        order = np.lexsort(np.array(means).round(2).T[::-1])
        segments = np.argsort(order)[segments]
    blocks = segments
    if segments.max() + 1 < min_segments:
        windows = len(segments)
        blocks = np.empty_like(segments)
        in_order_of_segments = np.argsort(segments, kind="stable")
        blocks[in_order_of_segments] = np.arange(windows) * min(NUM_BLOCKS, windows) // windows

    gains = np.array([segment.gains.ravel() for segment in runs.segments])
    gain = np.unique(gains, axis=0, return_inverse=True)[1].ravel()[runs.segment_indices()]
    if gain.max() == 0:
        return blocks
    return 2 * blocks + gain % 2
