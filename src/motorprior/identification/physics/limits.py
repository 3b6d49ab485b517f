"""Limits that the logs identify, decided by the windows in which they bind.

A motor saturates in few windows, and the loss grows slowly with large errors. The share of the
total loss that a limit saves therefore says little about it. Each limit of torque, speed or
acceleration is decided in three steps:

1. Propose a value: the best of descents from several values.
2. Fit the motor to every second block of its log, with the limit and without it.
3. Compare both fits on the windows of the other blocks in which the limit binds: in which it
   changes the simulated motion. The limit is kept if it saves MIN_SAVING of the losses of these
   windows, as a geometric mean, or if the saving is significant at LEVEL by Wilcoxon's signed-rank
   test of the logarithms of the ratios of the losses.

A motor with fewer than MIN_BINDING such windows keeps its limit in three cases: the saving is
significant together with the windows of its siblings, the motors of its model or class; it is
significant on all its windows in which the limit binds; or it is more than half of their losses.

A limit that is much lower than its siblings' limits, or than what its siblings reach without a
limit, is replaced by the siblings' median.

A limit that is not kept is off: DISABLED_LIMIT_FACTOR times the largest request or speed, or the
value in `NEGLIGIBLE` for an acceleration. With a limit that the logs do not identify, the motor
could saturate in other motions. A limit that the maker of a motor states is never off.

The torque-speed line is decided by its no-load speed, before the torque limit. Without a no-load
speed the line is a constant limit, its stall torque, which the torque limit takes over.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, parameters_of
from motorprior.actuator.optional_terms import NEGLIGIBLE
from motorprior.identification.physics.descents import RIGID_STEPS
from motorprior.identification.physics.effect_scales import effect_scale
from motorprior.identification.physics.estimate_uncertainty import blocks_of
from motorprior.identification.physics.motor_model_fit import (
    MAX_DEVIATION,
    OTHER_STD,
    ModelLevel,
    likelihood_scale,
)
from motorprior.identification.physics.motor_problem import (
    DISABLED_LIMIT_FACTOR,
    WEAK_PRECISION,
    centred_search,
    with_more_terms,
)
from motorprior.identification.physics.window_runs import SPEED_LIMITS, WindowRuns
from motorprior.identification.search import FIXED, WIDE, GaussianPrior, Search

LEVEL = 0.05  # of the signed-rank test
MIN_BINDING = 5  # fewer windows cannot be significant at this level
MIN_SAVING = 0.2  # share of the loss of the windows in which a limit binds
MIN_LOG_RATIO = -np.log(1.0 - MIN_SAVING)
MIN_LOG_RATIO_OF_FEW = np.log(2.0)  # for fewer than MIN_BINDING windows
# A limit binds in a window in which it changes a scaled error by more than this: 1 mrad or
# 0.03 rad/s.
MIN_CHANGE = 0.1
# Scan of a limit: number of values, and their range relative to what the log reached. Accelerations
# are relative to the value without effect.
SCANNED = 8
TORQUE_RANGE = (0.05, 0.8)
SPEED_RANGE = (1.02, 3.0)
ACCELERATION_RANGE = (2e-3, 0.5)
PROPOSAL_STEPS = ((10, WIDE),)
# in this order: a torque limit replaces a torque-speed line without a no-load speed
DECIDED = ("no_load_speed", "torque_limit", "profile_speed", "profile_acceleration")


@dataclass(frozen=True)
class LimitedMotors:
    """M motors whose limits are decided."""

    search: Search  # of the motors' problems, on ``runs``
    center: np.ndarray  # (K,) decoder outputs of the central motor
    terms: tuple[str, ...]  # optional terms of the motors
    runs: WindowRuns  # free runs over the logs
    fixed: np.ndarray  # (K,) mask of the constants that are not fitted
    groups: np.ndarray  # (M,) motors of one group are siblings
    level: ModelLevel | None = None  # motor models, near whose means the motors stay


def with_decided_limits(motors: LimitedMotors, x: np.ndarray) -> np.ndarray:
    """(M, K) unknowns x (M, K) of a fit, with the limits that the logs identify."""
    x = np.clip(x, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
    names = parameters_of(motors.terms)
    for name in DECIDED:
        if name not in names:
            continue
        column = names.index(name)
        all_stated = _is_stated(motors, column).all()
        if motors.fixed[column] or all_stated or _off_value(name, motors, x) == 0.0:
            continue
        decision = _LimitDecision(motors, x, name)
        x = decision.decided()
        if name == "no_load_speed":
            x = _without_flat_lines(motors, x, decision.is_off(x))
    return x


def _without_flat_lines(motors: LimitedMotors, x: np.ndarray, is_flat: np.ndarray) -> np.ndarray:
    """(M, K) the same motors, with a torque limit in place of lines without a no-load speed.

    ``is_flat`` (M,) is the mask of these motors. A torque limit that is stated remains.
    """
    names = parameters_of(motors.terms)
    limit = names.index("torque_limit")
    stall = names.index("stall_torque")
    log_stall = motors.center[stall] + x[:, stall]
    log_limit = np.minimum(motors.center[limit] + x[:, limit], log_stall)
    log_off = np.log(_off_value("stall_torque", motors, x))

    x = x.copy()
    takes_over = is_flat & ~_is_stated(motors, limit)
    x[takes_over, limit] = log_limit[takes_over] - motors.center[limit]
    x[is_flat, stall] = np.maximum(log_stall, log_off)[is_flat] - motors.center[stall]
    return np.clip(x, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)


def _is_stated(motors: LimitedMotors, column: int) -> np.ndarray:
    """(M,) whether the maker of each motor states a constant."""
    if motors.level is None:
        return np.zeros(len(motors.groups), bool)
    return motors.level.is_stated[motors.level.index, column]


def _off_value(name: str, motors: LimitedMotors, x: np.ndarray) -> float:
    """Value of a limit that is off; 0 if the logs do not move."""
    if name == "profile_acceleration":
        return NEGLIGIBLE[name]
    if name in SPEED_LIMITS:
        return DISABLED_LIMIT_FACTOR * motors.runs.max_speed
    kp = parameters_of(motors.terms).index("kp")
    requested_torque = np.exp(motors.center[kp] + x[:, kp]) * motors.runs.max_request  # (M,) [N·m]
    return DISABLED_LIMIT_FACTOR * float(requested_torque.max())


class _LimitDecision:
    """Decision on one limit of all motors, from the unknowns x (M, K) of a fit."""

    def __init__(self, motors: LimitedMotors, x: np.ndarray, name: str):
        names = parameters_of(motors.terms)
        self._motors = motors
        self._search = motors.search
        self._x = x
        self._column = names.index(name)
        self._is_limit = np.arange(len(names)) == self._column
        self._is_stated = _is_stated(motors, self._column)

        center = motors.center
        log_off = np.log(_off_value(name, motors, x)) - center[self._column]
        self._off = np.clip(log_off, x[:, self._column], MAX_LOG_FACTOR)
        values = {key: np.exp(center[index] + x[:, index]) for index, key in enumerate(names)}
        reached = effect_scale(name, values, motors.runs)  # (M,)
        with np.errstate(divide="ignore"):
            self._log_reached = np.log(reached) - center[self._column]
        self._scan = _scan(name, self._log_reached, center[self._column])

    def decided(self) -> np.ndarray:
        """(M, K) unknowns with the limit decided."""
        proposed = self._proposed()
        binds = self._binds(proposed)
        off = self._x.copy()
        off[:, self._column] = np.where(self._is_stated, off[:, self._column], self._off)
        with_limit = off.copy()
        without_limit = off.copy()
        is_test = np.zeros(binds.shape, bool)
        for motor in np.flatnonzero(binds.any(axis=1) & ~self._is_stated).tolist():
            is_test[motor] = is_held_out(self._motors.runs, binds[motor])
            fits = self._fitted_to_rest(motor, proposed, off, is_test[motor])
            with_limit[motor], without_limit[motor] = fits

        binds = self._binds(with_limit)
        losses_with = self._search.observation_losses(with_limit)
        losses_without = self._search.observation_losses(without_limit)
        ratios = np.log(losses_without + 1e-9) - np.log(losses_with + 1e-9)
        kept = np.array([self._is_kept(motor, binds, is_test, ratios) for motor in range(len(off))])
        kept |= self._is_stated
        value = np.where(kept, with_limit[:, self._column], self._off)
        contradicted, siblings_value = self._contradicted(value, kept)
        value = np.where(contradicted, siblings_value, value)

        # A fit that already has the decided limit stays as it is.
        binds_in_fit = self._binds(self._x)
        losses_of_fit = self._search.observation_losses(self._x)
        is_worse = np.sum(binds * (losses_of_fit - (1.0 + MIN_SAVING) * losses_with), axis=1) > 0.0
        is_bound = binds_in_fit.any(axis=1)
        is_changed = np.where(kept, is_worse | ~is_bound, is_bound) | contradicted
        is_changed &= ~self._is_stated
        x = np.where(kept[:, None], self._x, off)
        changed = np.flatnonzero(is_changed)
        if len(changed):
            start = np.where(kept[:, None], with_limit, without_limit)
            start[:, self._column] = value
            holds_limit = ~kept | contradicted
            x[changed] = self._descended(self._search, start, holds_limit, changed)
        return x

    def is_off(self, x: np.ndarray) -> np.ndarray:
        """(M,) whether the limit of motors x (M, K) is off."""
        return ~self._is_stated & (x[:, self._column] >= self._off - 1e-9)

    def _proposed(self) -> np.ndarray:
        """(M, K) the best of the fit and of descents from the values of the scan."""
        motors = self._search.all_problems
        count = self._scan.shape[1]
        starts = np.repeat(self._x[None], count, axis=0)  # (SCANNED, M, K)
        starts[:, :, self._column] = self._scan.T
        prior = self._prior(self._x, np.broadcast_to(self._motors.fixed, self._x.shape))
        prior.precision[:, self._column] = 0.0
        size = starts.shape[-1]
        fit = self._search.at(self._x, prior)
        fits = self._search.descend(
            starts.reshape(-1, size), prior, PROPOSAL_STEPS, np.tile(motors, count)
        )
        for index in range(count):
            fit = fit.better(fits.subset(index * len(motors) + motors))
        return np.clip(fit.x, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)

    def _prior(self, start: np.ndarray, frozen: np.ndarray) -> GaussianPrior:
        """Prior of the motors, which are ``frozen`` (M, K) at ``start`` (M, K) or near it."""
        prior = GaussianPrior(start, np.where(frozen, FIXED, WEAK_PRECISION))
        if self._motors.level is None:
            return prior
        scale = likelihood_scale(self._search, self._search.losses(self._x))
        near_siblings = self._motors.level.prior_of(self._x, scale, self._motors.fixed)
        return GaussianPrior(
            np.where(frozen, start, near_siblings.mean),
            np.where(frozen, FIXED, near_siblings.precision),
        )

    def _fitted_to_rest(
        self, motor: int, proposed: np.ndarray, off: np.ndarray, is_test: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(K,) unknowns of a motor with and without its limit, fitted to windows without a test.

        ``proposed`` and ``off`` (M, K) are the starts; ``is_test`` (N,) are the held-out windows.
        """
        is_training = np.zeros(self._motors.runs.windows, bool)
        is_training[self._motors.runs.counted[~is_test]] = True
        runs = self._motors.runs.counting(is_training)
        search = centred_search(self._motors.center, self._motors.terms, runs)
        problem = np.array([motor])
        free = np.zeros(len(off), bool)
        with_limit = self._descended(search, proposed, free, problem)
        without_limit = self._descended(search, off, ~free, problem)
        return with_limit[0], without_limit[0]

    def _descended(
        self, search: Search, start: np.ndarray, holds_limit: np.ndarray, motors: np.ndarray
    ) -> np.ndarray:
        """(m, K) unknowns of ``motors`` (m,) after a descent from ``start`` (M, K).

        The limit of motors in ``holds_limit`` (M,) is fixed.
        """
        frozen = self._motors.fixed | (holds_limit[:, None] & self._is_limit)
        prior = self._prior(start, frozen)
        x = search.descend(start[motors], prior, RIGID_STEPS, motors).x
        return np.clip(np.where(frozen[motors], start[motors], x), -MAX_LOG_FACTOR, MAX_LOG_FACTOR)

    def _binds(self, x: np.ndarray) -> np.ndarray:
        """(M, N) mask of the windows in which the limit of motors x (M, K) binds."""
        off = x.copy()
        off[:, self._column] = np.maximum(self._off, x[:, self._column])
        return np.array(
            [
                _changes(self._search, x[motor], self._search, off[motor], motor)
                for motor in range(len(x))
            ]
        )

    def _is_kept(
        self, motor: int, binds: np.ndarray, is_test: np.ndarray, ratios: np.ndarray
    ) -> bool:
        """Whether the windows in which the limit of a motor binds are simulated better with it.

        ``binds`` and ``is_test`` (M, N) are masks; ``ratios`` (M, N) are the logarithms of the
        losses without a limit over the losses with it.
        """
        own = ratios[motor, binds[motor]]
        own_test = ratios[motor, binds[motor] & is_test[motor]]
        if len(own_test) >= MIN_BINDING:
            return own_test.mean() > MIN_LOG_RATIO or _is_significant(own_test)

        siblings = self._motors.groups == self._motors.groups[motor]
        of_siblings = ratios[binds & is_test & siblings[:, None]]
        if len(own) and len(of_siblings) >= MIN_BINDING and _is_significant(of_siblings):
            return own.mean() > 0.0
        if len(own) >= MIN_BINDING and _is_significant(own):
            return True
        return len(own) > 0 and own.mean() > MIN_LOG_RATIO_OF_FEW

    def _contradicted(self, value: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(M,) whether siblings contradict a low limit, and the value (M,) that they suggest.

        ``value`` (M,) are the limits, and ``kept`` (M,) those that are not off. A sibling without a
        limit has at least the one that its log reached.
        """
        shift = np.zeros(len(value))
        if self._motors.level is not None:
            shift = self._motors.level.shift[:, self._column]
        own = value - shift
        lower_bound = np.where(kept, value, self._log_reached) - shift
        contradicted = np.zeros(len(value), bool)
        suggested = value.copy()
        for motor in np.flatnonzero(kept):
            is_sibling = self._motors.groups == self._motors.groups[motor]
            is_sibling[motor] = False
            if not is_sibling.any():
                continue
            theirs = np.where(kept, own, np.maximum(lower_bound, own[motor]))[is_sibling]
            std = OTHER_STD * np.sqrt(1.0 + 1.0 / is_sibling.sum())
            if np.median(theirs) - own[motor] > MAX_DEVIATION * std:
                contradicted[motor] = True
                known = is_sibling & kept
                suggested[motor] = self._off[motor]
                if known.any():
                    suggested[motor] = np.median(own[known]) + shift[motor]
        return contradicted, np.clip(suggested, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)


def binding_windows(
    runs: WindowRuns, outputs: np.ndarray, terms: tuple[str, ...], limits: Iterable[str]
) -> np.ndarray:
    """(M, N) mask of the windows in which any of the ``limits``, optional terms, binds.

    ``outputs`` (M, K) are the decoder outputs of the motors with ``terms``.
    """
    others = tuple(name for name in terms if name not in limits)
    outputs_without = with_more_terms(outputs, terms, others, runs)
    search, x = _search_around(outputs, terms, runs)
    search_without, x_without = _search_around(outputs_without, others, runs)
    return np.array(
        [
            _changes(search, x[motor], search_without, x_without[motor], motor)
            for motor in range(len(outputs))
        ]
    )


def _search_around(
    outputs: np.ndarray, terms: tuple[str, ...], runs: WindowRuns
) -> tuple[Search, np.ndarray]:
    """The search around the center of decoder outputs (M, K), and their unknowns (M, K)."""
    center = 0.5 * (outputs.min(axis=0) + outputs.max(axis=0))
    return centred_search(center, terms, runs), outputs - center


def _changes(
    search: Search, x: np.ndarray, other_search: Search, other_x: np.ndarray, motor: int
) -> np.ndarray:
    """(N,) mask of the windows in which two versions of a motor differ by more than MIN_CHANGE."""
    with np.errstate(over="ignore", invalid="ignore"):
        residuals = search.problem.residuals(x[None], np.array([motor]))
        other_residuals = other_search.problem.residuals(other_x[None], np.array([motor]))
        change = np.abs(residuals - other_residuals).reshape(search.problem.observations, -1)
    return ~(change.max(axis=1) <= MIN_CHANGE)


def is_held_out(runs: WindowRuns, binds: np.ndarray) -> np.ndarray:
    """(N,) mask of the counted windows that are held out.

    They are in every second block of the logs. Windows in which a limit ``binds`` (N,) are held out
    in every second sequence of such windows, or every second one if there is only one sequence.
    None is held out if no other window would be left.
    """
    blocks = np.unique(blocks_of(runs), return_inverse=True)[1]
    is_first = binds & ~np.concatenate([[False], binds[:-1]])
    sequences = np.cumsum(is_first)  # (N,) number of the sequence, from 1
    if sequences[-1] == 1:
        sequences = np.cumsum(binds)
    held_out = np.where(binds, sequences, blocks) % 2 == 1
    return held_out & ~held_out.all()


def _scan(name: str, log_reached: np.ndarray, center: float) -> np.ndarray:
    """(M, SCANNED) values of a limit to try, relative to the ``center``."""
    ends = TORQUE_RANGE if name == "torque_limit" else SPEED_RANGE
    if name == "profile_acceleration":
        log_reached = np.full(len(log_reached), np.log(NEGLIGIBLE[name]) - center)
        ends = ACCELERATION_RANGE
    factors = np.linspace(np.log(ends[0]), np.log(ends[1]), SCANNED)
    return np.clip(log_reached[:, None] + factors, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)


def _is_significant(ratios: np.ndarray) -> bool:
    """Whether the logarithms of ratios are positive, by the signed-rank test."""
    from scipy.stats import wilcoxon  # here: it takes half a second to import

    if not ratios.any():
        return False
    return float(cast(Any, wilcoxon(ratios, alternative="greater")).pvalue) < LEVEL
