"""A fleet fitted to real logs: its centre with standard errors, and the spread between motors.

Centre: descents from several starts (`identification.search`), with the fleet as prior.

Single motors: offsets y from the centre have the prior N(0, s²), where s is the spread between motors. About the centre
the residuals are linear, r + J·y. A wide prior overfits, so s is a multiple of the starting fleet's spread, selected
by leave-one-log-out cross-validation of the replay error. The fitted spread is √(mean of y² + var(y)), one step of
expectation maximisation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.bench.fleet import Distribution, Fleet
from motorprior.identification.search import WIDE, GaussianPrior, Search
from motorprior.progress import SILENT, Progress
from motorprior.studies.fleet_problem import FleetProblem

_UNIT = 1.0 / (3.0 * WIDE)  # unit of the parameters, in prior standard deviations: differences span a third of one
_SPREAD_MULTIPLES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
_MIN_SPREAD = 0.01  # relative


@dataclass(frozen=True)
class _Optimum:
    """Result of a search: (P,) centre, its cost, and its (P, P) covariance by Laplace's method."""

    x: np.ndarray
    cost: float
    covariance: np.ndarray


class _CentreProblem:
    """Residuals of some logs, see `search.Problem`; parameters are relative to the prior, in _UNIT.

    mujoco.sysid is not used: it fits parameters of a model's own actuators within bounds, while these motors, with
    delay, rotor and backlash, run outside the engine, and the fleet is a Gaussian prior.
    """

    count = observations = 1

    def __init__(self, problem: FleetProblem, logs: Sequence[str]):
        self._problem, self._logs = problem, logs
        self.weight = float(len(problem.residuals(logs, problem.mean)))

    def center(self, x: np.ndarray) -> np.ndarray:
        """(P,) of the problem."""
        return self._problem.mean + _UNIT * self._problem.prior_std * x

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, N) at x (L, P)."""
        return np.stack([self._problem.residuals(self._logs, self.center(row)) for row in x])


def _optimum(problem: FleetProblem, logs: Sequence[str], start: np.ndarray, iterations: int) -> _Optimum:
    centre, size, scale = _CentreProblem(problem, logs), len(problem.mean), _UNIT * problem.prior_std
    search, prior = Search(centre), GaussianPrior(np.zeros(size), np.full(size, _UNIT**2))
    found = search.descend(((start - problem.mean) / scale)[None], prior, ((iterations, WIDE),))
    covariance = np.linalg.inv(search.curvatures(found.x, WIDE)[0] + np.diag(prior.precision)) * scale * scale[:, None]
    return _Optimum(centre.center(found.x[0]), float(found.energy[0]), covariance)


@dataclass(frozen=True)
class Calibration:
    """A fitted fleet."""

    center: np.ndarray  # (P,) best centre of all searches
    error: np.ndarray  # (P,) its standard error: the larger of Laplace's and, for several logs, the jackknife's
    offsets: np.ndarray  # (excited joints · varying parameters,) of single motors from it, see `FleetProblem.actuator`
    spread: dict[str, float]  # constant -> standard deviation between motors; empty if the fleet has no spread
    # log name -> (P,) centre without this log, and offsets from it; empty for a single log
    left_out: dict[str, tuple[np.ndarray, np.ndarray]]


def calibrate(
    problem: FleetProblem, starts: int, iterations: int, seed: int, progress: Progress = SILENT
) -> Calibration:
    """Fit a fleet, by ``starts`` searches of at most this many iterations.

    The first starts at the fleet's centre, the others at samples of the prior.
    """
    names, mean = list(problem.replayers), problem.mean
    samples = problem.prior_std * np.random.default_rng(seed).standard_normal((starts - 1, len(mean)))
    logs_left_out = names if len(names) > 1 else []
    searches = 1 + starts + len(logs_left_out) + 1
    with progress.start(f"calibrate on {len(names)} real logs", searches) as task:

        def fit(problem: FleetProblem, logs: Sequence[str], start: np.ndarray) -> _Optimum:
            task.advance()
            return _optimum(problem, logs, start, iterations)

        first = fit(problem, names, mean).x
        problem = problem.with_residual_deviation(first)
        best = min((fit(problem, names, start) for start in (first, *(mean + samples))), key=lambda each: each.cost)
        left_out = {name: fit(problem, [log for log in names if log != name], mean).x for name in logs_left_out}
        offsets, spread, offsets_left_out = single_motors(problem, best.x, left_out)
        task.advance()
    error = np.sqrt(np.diag(best.covariance))
    if left_out:
        # jackknife over n logs: variance (n-1)/n·Σ(x_i - mean)², x_i the fit without log i (Efron & Stein 1981)
        without = np.array(list(left_out.values()))
        error = np.maximum(error, np.sqrt((len(without) - 1) * np.var(without, axis=0)))
    both = {name: (left_out[name], offsets_left_out[name]) for name in left_out}
    return Calibration(best.x, error, offsets, spread, both)


def calibrated_fleet(problem: FleetProblem, found: Calibration) -> Fleet:
    """The fleet with its fitted constants; all others stay."""
    parameters = dict(problem.fleet.parameters)
    for parameter, x, error in zip(problem.parameters, found.center, found.error, strict=True):
        spread = found.spread.get(parameter.name, parameter.spread)
        values = {"center": parameter.value(x), "spread": spread, "center_uncertainty": float(error)}
        if not parameter.is_log:
            values["minimum"] = parameter.minimum
        rounded = {key: float(f"{value:.4g}") for key, value in values.items()}
        parameters[parameter.name] = Distribution("lognormal" if parameter.is_log else "normal", rounded)
    return replace(problem.fleet, name=f"{problem.fleet.name}_calibrated", parameters=parameters)


def single_motors(
    problem: FleetProblem, center: np.ndarray, left_out: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, float], dict[str, np.ndarray]]:
    """Fit offsets of single motors, linearly about the (P,) centre of all logs.

    ``left_out``: log name -> (P,) centre fitted without this log; empty for a single log. Returns offsets and
    spread, see `Calibration`; log name -> offsets without this log.
    """
    varying, names = [problem.parameters[i] for i in problem.varying], list(problem.replayers)
    spread = np.tile([each.spread for each in varying], len(problem.joints))
    if not varying:
        return spread, {}, dict.fromkeys(left_out, spread)
    others = {name: _linear(problem, [log for log in names if log != name], x, spread) for name, x in left_out.items()}

    def error(multiple: float) -> float:
        fitted = {name: _offsets(*each, multiple * spread) for name, each in others.items()}
        return sum(problem.rmse(name, left_out[name], offsets) for name, offsets in fitted.items())

    prior = (min(_SPREAD_MULTIPLES, key=error) if others else 1.0) * spread
    residuals, slope = _linear(problem, names, center, spread)
    offsets = _offsets(residuals, slope, prior)
    variance = np.diag(np.linalg.inv(slope.T @ slope + np.diag(prior**-2)))
    each_motor = (offsets**2 + variance).reshape(len(problem.joints), len(varying))
    between = np.maximum(np.sqrt(each_motor.mean(axis=0)), _MIN_SPREAD).tolist()
    found = {each.name: s for each, s in zip(varying, between, strict=True)}
    return offsets, found, {name: _offsets(*each, prior) for name, each in others.items()}


def _linear(
    problem: FleetProblem, logs: Sequence[str], center: np.ndarray, spread: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals r (N,) of logs at a centre, and their Jacobian (N, offsets)."""
    columns = [
        (problem.residuals(logs, center, away) - problem.residuals(logs, center, -away)) / (2.0 * away.max())
        for away in np.diag(spread)
    ]
    return problem.residuals(logs, center, np.zeros_like(spread)), np.stack(columns, axis=1)


def _offsets(residuals: np.ndarray, slope: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """(offsets,) minimum of the sum of squares of r + J·y, with the prior N(0, spread²) of y."""
    return -np.linalg.solve(slope.T @ slope + np.diag(spread**-2), slope.T @ residuals)
