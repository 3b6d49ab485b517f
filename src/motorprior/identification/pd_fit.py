"""Fit a PD, with or without friction, until restarting the search improves nothing; what that took is recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.friction_pd import FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.identification.baselines import START, closed_loop_error, least
from motorprior.logs.motor_log import MotorLog

ROUNDS, ROUND = 6, 600
"""Most searches, see `baselines.least`, each from the best of the one before; most evaluations of each."""
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

    Nelder-Mead over the logarithms of the ``free`` constants, restarted with a new simplex from its own best.

    Args:
        log: of a bench.
        start: kp, kd and torque_limit to begin with.
        free: names of the constants to fit.
        progress: called after every evaluation.
    """
    judge = closed_loop_error(log, progress)
    known = {name: value for name, value in start.items() if name not in free}

    def constants(logs: np.ndarray) -> dict[str, float]:
        return known | {name: float(value) for name, value in zip(free, np.exp(logs), strict=True)}

    def cost(logs: np.ndarray) -> float:
        return judge(pd_motors(constants(logs), log.num_joints))

    best, evaluations = np.log([START.get(name, start.get(name, 0.0)) for name in free]), 0
    error, converged = cost(best), False
    for _ in range(ROUNDS):
        found = least(cost, best, ROUND)
        evaluations += found.nfev
        converged = found.nfev < ROUND and error - found.fun < max(CONVERGED * error, NOTHING)
        best, error = found.x, float(found.fun)
        if converged:
            break
    return PdFit(constants(best), error, evaluations, bool(converged))
