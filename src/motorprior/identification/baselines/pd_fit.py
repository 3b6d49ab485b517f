"""Fit of PDs, the same for all motors of a log: gains alone, with armature and delay, or with friction as well.

`fit_pd` restarts Nelder-Mead until a restart improves nothing. `tuned_pd` needs no starting point. A log may not
separate a large armature from a long delay, and a local search does not move from one to the other, or find a torque
limit from none. Searches on part of the log therefore start from several armatures and delays, each at its best gains:
first without a torque limit, then with the best one. The best search of each kind continues on the whole log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.identification.baselines.replay_error import AtGains, closed_loop_error, unchanged
from motorprior.logs.motor_log import MotorLog

GAINS = ("kp", "kd", "torque_limit")  # fitted for an ideal PD
WITH_ROTOR = (*GAINS, "armature", "delay")  # for the tuned PD
WITH_FRICTION = (*WITH_ROTOR, "coulomb")
START = {"armature": 0.001, "delay": 0.008, "coulomb": 0.02}  # of constants that a nominal PD lacks [kg·m²], [s], [N·m]
_DELAY = 0.01  # unit of the delay in a search [s]; a logarithmic variable could not leave 0
# kp [N·m/rad] and kd/kp [s] that are tried: of small servos to large direct drives
_TRIED_GAINS = tuple(product((2.0, 8.0, 32.0, 128.0), (0.02, 0.06, 0.18)))
_NO_LIMIT, _TRIED_LIMITS = 1000.0, tuple(np.geomspace(0.4, 40.0, 13).tolist())  # [N·m]
_TRIED_LAGS = {"armature": (0.001, 0.02), "delay": (0.008, 0.04)}  # [kg·m²], [s]
_MAX_SEGMENTS, _MAX_ROWS = 16, 8000  # of the part of a log on which searches start

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Budget:
    """Limits of a fit: evaluations of each first search, number of restarts, evaluations of each restart."""

    first: int = 100
    restarts: int = 6
    evaluations: int = 600

    def total(self, starts: int) -> int:
        """Maximum for a fit with this number of starting points."""
        return starts * self.first + self.restarts * self.evaluations


THOROUGH = Budget()
_SHORT, _LONG = Budget(first=60, restarts=0), Budget(first=80, restarts=3, evaluations=150)
_STARTS = prod(map(len, _TRIED_LAGS.values()))
# approximate number of evaluations of `tuned_pd` and `best_gains`
TUNING = _STARTS * (len(_TRIED_GAINS) + len(_TRIED_LIMITS)) + 2 * _STARTS * _SHORT.first + _LONG.total(2)
GAINS_ALONE = _LONG.total(1)


@dataclass(frozen=True)
class PdFit:
    """Constants by name; mean joint error on the log [rad]; evaluations used; whether the fit converged."""

    constants: Mapping[str, float]
    error: float
    evaluations: int
    converged: bool


def pd_motors(constants: Mapping[str, float], count: int) -> Actuator:
    """``count`` equal motors with these constants."""
    return IdealPd.uniform(count, **constants)


def fit_pd(
    log: MotorLog,
    starts: Sequence[Mapping[str, float]],
    free: tuple[str, ...],
    progress: Progress | None = None,
    budget: Budget = THOROUGH,
    at_gains: AtGains = unchanged,
) -> PdFit:
    """One PD for all motors of a log with known loads, with the smallest closed-loop error.

    Nelder-Mead over the ``free`` constants: the delay in units of 10 ms, the logarithms of the others. It
    searches from each start, then restarts from the best with a new simplex, until a restart lowers the error by less
    than 0.2 %. The other constants are those of the first start. ``progress`` is called after every evaluation;
    ``at_gains`` gives the PD the gains of each segment.
    """
    error_of = closed_loop_error(log, progress, at_gains)
    fixed, delayed = {name: value for name, value in starts[0].items() if name not in free}, np.array(free) == "delay"

    def constants(point: np.ndarray) -> dict[str, float]:
        # clipped, or a search over an unidentifiable constant would overflow
        values = np.where(delayed, _DELAY * np.abs(point), np.exp(np.clip(point, -100.0, 100.0)))
        return fixed | {name: float(value) for name, value in zip(free, values, strict=True)}

    def search(first: np.ndarray, evaluations: int) -> OptimizeResult:
        simplex = np.vstack([first, *(first + 0.3 * row for row in np.eye(len(first)))])
        options = {"maxfev": evaluations, "xatol": 1e-3, "fatol": 1e-6, "initial_simplex": simplex}
        cost = lambda point: error_of(pd_motors(constants(point), log.num_joints))  # noqa: E731
        return minimize(cost, first, method="Nelder-Mead", options=options)

    points = [np.array([start[name] for name in free]) for start in starts]
    searches = [search(np.where(delayed, point / _DELAY, np.log(point)), budget.first) for point in points]
    best, evaluations, converged = min(searches, key=lambda each: each.fun), sum(each.nfev for each in searches), False
    for _ in range(budget.restarts):
        before, best = best, search(best.x, budget.evaluations)
        evaluations += best.nfev
        converged = best.nfev < budget.evaluations and before.fun - best.fun < max(0.002 * before.fun, 1e-5)
        if converged:
            break
    return PdFit(constants(best.x), float(best.fun), evaluations, bool(converged))


def starting_points(
    start: Mapping[str, float], free: tuple[str, ...], lags: Mapping[str, Iterable[float]]
) -> list[dict[str, float]]:
    """``start`` with every combination of the free ``lags``; missing free constants are those of START."""
    names = [name for name in lags if name in free]
    common = {name: START[name] for name in free if name in START} | dict(start)
    return [common | dict(zip(names, values, strict=True)) for values in product(*(lags[name] for name in names))]


def tuned_pd(log: MotorLog, progress: Progress | None = None, at_gains: AtGains = unchanged) -> IdealPd:
    """One PD with armature and delay for all M motors of a log with known loads; M copies of it.

    ``progress`` is called after every evaluation; ``at_gains`` gives the PD the gains of each segment.
    """
    part = _part(log)
    error = closed_loop_error(part, progress, at_gains)

    def cost(constants: Mapping[str, float]) -> float:
        return error(pd_motors(constants, log.num_joints))

    def short_fit(start: Mapping[str, float]) -> PdFit:
        return fit_pd(part, [start], WITH_ROTOR, progress, _SHORT, at_gains)

    gains = [{"kp": kp, "kd": kp * ratio} for kp, ratio in _TRIED_GAINS]
    lags = starting_points({"torque_limit": _NO_LIMIT}, WITH_ROTOR, _TRIED_LAGS)
    unlimited = [short_fit(min((lag | each for each in gains), key=cost)) for lag in lags]
    best = [min(({**fit.constants, "torque_limit": limit} for limit in _TRIED_LIMITS), key=cost) for fit in unlimited]
    limited = [short_fit(each) for each in best]
    starts = [min(found, key=lambda each: each.error).constants for found in (unlimited, limited)]
    found = fit_pd(log, starts, WITH_ROTOR, progress, _LONG, at_gains)
    return IdealPd.uniform(log.num_joints, **found.constants)


def _part(log: MotorLog) -> MotorLog:
    """Windows spread over a log, each as a segment; the whole log if it is short."""
    if log.num_rows <= _MAX_ROWS:
        return log
    segments = log.segment_slices()
    index = np.linspace(0, len(segments) - 1, min(len(segments), _MAX_SEGMENTS), dtype=int)
    windows = [
        window
        for one in (segments[each] for each in index)
        for window in np.array_split(np.arange(one.start, one.stop), _MAX_SEGMENTS // len(index))
    ]
    windows = [window[: _MAX_ROWS // len(windows)] for window in windows]
    number = np.repeat(np.arange(len(windows)), [len(window) for window in windows])
    return replace(log.rows(np.concatenate(windows)), segment=number)


def best_gains(log: MotorLog, nominal: IdealPd, progress: Progress | None = None) -> IdealPd:
    """One ideal PD for all M motors of the log, fitted from the gains and the limit of a nominal one; M copies."""
    start = {name: float(values[0]) for name, values in vars(nominal).items()}
    return IdealPd.uniform(log.num_joints, **fit_pd(log, [start], GAINS, progress, _LONG).constants)


def repeated(model: IdealPd, num_motors: int) -> IdealPd:
    """``num_motors`` copies of the first motor of ``model``."""
    return IdealPd.uniform(num_motors, **{name: float(values[0]) for name, values in vars(model).items()})
