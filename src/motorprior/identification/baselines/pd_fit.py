"""Fit a PD, with or without friction, until restarting the search improves nothing; what that took is recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.friction_pd import FrictionPd
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.identification.baselines.replay_error import Told, as_they_are, closed_loop_error
from motorprior.logs.motor_log import MotorLog

# Where the fit of a constant begins, that a nominal PD does not have [kg·m²], [s], [N·m]
START = {"armature": 0.001, "delay": 0.008, "coulomb": 0.02}
_DELAY = 0.01  # [s]; a delay is searched in this unit, since its logarithm has no way back from 0
_FAR = 100.0  # Of logarithms: where a log tells nothing of a constant, the search goes on until it overflows
# A search that lowers the error by a smaller share of it, or by less than so many rad, ends the fit
CONVERGED, NOTHING = 0.002, 1e-5


@dataclass(frozen=True)
class Effort:
    """Most evaluations of a fit: of the search from each beginning, and of each of the further ones, so many rounds."""

    first: int = 100
    rounds: int = 6
    evaluations: int = 600

    def most(self, starts: int) -> int:
        """Evaluations of a fit with so many beginnings."""
        return starts * self.first + self.rounds * self.evaluations


THOROUGH = Effort()


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
    log: MotorLog,
    starts: Sequence[Mapping[str, float]],
    free: tuple[str, ...],
    progress: Callable[[int], None] | None = None,
    effort: Effort = THOROUGH,
    told: Told = as_they_are,
) -> PdFit:
    """One PD for all motors of a log with known loads, with the least closed-loop error on the whole of it.

    Nelder-Mead over the ``free`` constants: the delay in units of _DELAY, the logarithms of the others. A search from
    each start, then, from the best, restarts with a new simplex.

    Args:
        log: with known loads.
        starts: constants to begin with, by name; what is not free is that of the first.
        free: names of the constants to fit.
        progress: called after every evaluation.
        effort: at most.
        told: what the PD is told of each segment.
    """
    judge = closed_loop_error(log, progress, told)
    known, delayed = {name: value for name, value in starts[0].items() if name not in free}, np.array(free) == "delay"

    def constants(point: np.ndarray) -> dict[str, float]:
        values = np.where(delayed, _DELAY * np.abs(point), np.exp(np.clip(point, -_FAR, _FAR)))
        return known | {name: float(value) for name, value in zip(free, values, strict=True)}

    def cost(point: np.ndarray) -> float:
        return judge(pd_motors(constants(point), log.num_joints))

    points = [np.array([start[name] for name in free]) for start in starts]
    searches = [_least(cost, np.where(delayed, point / _DELAY, np.log(point)), effort.first) for point in points]
    evaluations, converged = sum(found.nfev for found in searches), False
    best, error = min(((found.x, float(found.fun)) for found in searches), key=lambda each: each[1])
    for _ in range(effort.rounds):
        found = _least(cost, best, effort.evaluations)
        evaluations += found.nfev
        converged = found.nfev < effort.evaluations and error - found.fun < max(CONVERGED * error, NOTHING)
        best, error = found.x, float(found.fun)
        if converged:
            break
    return PdFit(constants(best), error, evaluations, bool(converged))


def beginnings(
    start: Mapping[str, float], free: tuple[str, ...], lags: Mapping[str, Iterable[float]]
) -> list[dict[str, float]]:
    """``start`` with every combination of the lags that are free; START says what else is free and it lacks."""
    names = [name for name in lags if name in free]
    common = {name: START[name] for name in free if name in START} | dict(start)
    return [common | dict(zip(names, values, strict=True)) for values in product(*(lags[name] for name in names))]


def _least(cost: Callable[[np.ndarray], float], first: np.ndarray, evaluations: int) -> OptimizeResult:
    """Nelder-Mead search over (N,) numbers from ``first``, with so many evaluations at most."""
    simplex = np.vstack([first, *(first + 0.3 * row for row in np.eye(len(first)))])
    options = {"maxfev": evaluations, "xatol": 1e-3, "fatol": 1e-6, "initial_simplex": simplex}
    return minimize(cost, first, method="Nelder-Mead", options=options)
