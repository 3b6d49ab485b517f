"""Fit a PD, with or without friction, until restarting the search improves nothing; what that took is recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.friction_pd import FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.identification.baselines.tuned_pds import START, closed_loop_error, least
from motorprior.logs.motor_log import MotorLog

_ROUNDS, _ROUND = 6, 600
"""Most searches, see `baselines.least`, each from the best of the one before; most evaluations of each."""
_FIRST_ROUND = 100
"""Most evaluations of the search from each beginning."""
_BEGINNINGS = tuple(
    (("armature", armature), ("delay", delay)) for armature in (0.001, 0.005) for delay in (0.002, 0.008)
)
"""Constants to begin with [kg·m²], [s]: of a slow rotor and of a late one the error is alike."""
MOST_EVALUATIONS = len(_BEGINNINGS) * _FIRST_ROUND + _ROUNDS * _ROUND
"""Of a fit."""
_DELAY = 0.01
"""[s]; a delay is searched in this unit, since its logarithm has no way back from 0."""
CONVERGED, NOTHING = 0.002, 1e-5
"""A search that lowers the error by a smaller share of it, or by less than so many rad, ends the fit."""


@dataclass(frozen=True)
class PdFit:
    """Attributes: constants by name; mean joint error on the log [rad]; evaluations it took; whether it converged."""

    constants: Mapping[str, float]
    error: float
    evaluations: int
    converged: bool


def pd_motors(constants: Mapping[str, float], count: int) -> Actuator:
    """``count`` equal motors; with friction if ``coulomb`` is among the constants."""
    values = dict(constants)
    coulomb = values.pop("coulomb", None)
    pd = IdealPd.uniform(count, **values)
    return pd if coulomb is None else FrictionPd(pd, np.full(count, coulomb))


def fit_to_the_end(
    log: MotorLog, start: Mapping[str, float], free: tuple[str, ...], progress: Callable[[int], None]
) -> PdFit:
    """One PD for all motors of a log with known loads, with the least closed-loop error on the whole of it.

    Nelder-Mead over the ``free`` constants: the delay in units of _DELAY, the logarithms of the others. A search from
    each of some armatures and delays, then, from the best, restarts with a new simplex.

    Args:
        log: of a bench.
        start: kp, kd and torque_limit to begin with.
        free: names of the constants to fit.
        progress: called after every evaluation.
    """
    judge = closed_loop_error(log, progress)
    known = {name: value for name, value in start.items() if name not in free}

    def constants(point: np.ndarray) -> dict[str, float]:
        values = np.where(np.array(free) == "delay", _DELAY * np.abs(point), np.exp(point))
        return known | {name: float(value) for name, value in zip(free, values, strict=True)}

    def cost(point: np.ndarray) -> float:
        return judge(pd_motors(constants(point), log.num_joints))

    searches = [least(cost, first, _FIRST_ROUND) for first in _beginnings(start, free)]
    evaluations, converged = sum(found.nfev for found in searches), False
    best, error = min(((found.x, float(found.fun)) for found in searches), key=lambda each: each[1])
    for _ in range(_ROUNDS):
        found = least(cost, best, _ROUND)
        evaluations += found.nfev
        converged = found.nfev < _ROUND and error - found.fun < max(CONVERGED * error, NOTHING)
        best, error = found.x, float(found.fun)
        if converged:
            break
    return PdFit(constants(best), error, evaluations, bool(converged))


def _beginnings(start: Mapping[str, float], free: tuple[str, ...]) -> list[np.ndarray]:
    """Points to search from: every one of _BEGINNINGS that differs in what is free."""
    made = {tuple((START | dict(start) | dict(values))[name] for name in free) for values in _BEGINNINGS}
    delayed = np.array(free) == "delay"
    return [np.where(delayed, np.array(point) / _DELAY, np.log(point)) for point in sorted(made)]
