"""A fleet fitted to real logs: its centre with standard errors, several optima, and the spread between motors.

Centre: Gauss-Newton from several starts, with the fleet as prior. Single motors: offsets y from the centre have the
prior N(0, s²), s the spread between motors; about the centre the residuals are r + J·y. A wide prior overfits, so s is
selected by leave-one-log-out: the multiple of the starting fleet's spread with the smallest mean replay error on the
log left out, where centre and offsets are fitted to the other logs. The fitted spread is the root of the mean of
y² + var(y) (one step of expectation maximisation).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from motorprior.bench.fleet import Distribution, Fleet
from motorprior.studies.fleet_problem import FleetProblem, Unknown
from motorprior.studies.gauss_newton import GaussianPrior, Optimum, Residuals, gauss_newton_step, jacobian, search

IDENTIFIABLE = 0.5  # a constant is identifiable if its posterior variance is below this share of the prior's
_SPREAD_MULTIPLES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
_MIN_SPREAD = 0.01  # relative

Linear: TypeAlias = tuple[np.ndarray, np.ndarray]  # residuals r (N,) of a log at a centre, Jacobian J (N, offsets)


@dataclass(frozen=True)
class SingleMotors:
    """Differences between motors.

    Attributes:
        offsets: (excited joints · differing unknowns,) from the centre, see `FleetProblem.motors`.
        left_out: log name -> the same without this log, from the centre without it; empty for a single log.
        spread: constant -> standard deviation between motors; empty if the fleet has no spread.
    """

    offsets: np.ndarray
    left_out: dict[str, np.ndarray]
    spread: dict[str, float]


@dataclass(frozen=True)
class Calibration:
    """A fitted fleet.

    Attributes:
        optima: of all searches, the best first.
        error: (unknowns,) standard error of the best: the larger of Laplace's and, for several logs, the jackknife's.
        left_out: log name -> (unknowns,) centre without this log; empty for a single log.
        motors: differences between motors about the best optimum.
    """

    optima: tuple[Optimum, ...]
    error: np.ndarray
    left_out: dict[str, np.ndarray]
    motors: SingleMotors

    @property
    def center(self) -> np.ndarray:
        """(unknowns,) of the best optimum."""
        return self.optima[0].x


def calibrate(
    problem: FleetProblem, starts: int, iterations: int, seed: int, advance: Callable[[], None] = lambda: None
) -> Calibration:
    """Fit a fleet.

    Args:
        problem: fleet and logs.
        starts: number of searches; the first starts at the fleet's centre, the others at samples of the prior.
        iterations: maximum of each search.
        seed: of the samples.
        advance: called once per search, `num_searches` times in all.
    """
    names, prior, rng = list(problem.replayers), problem.prior, np.random.default_rng(seed)
    first = search(lambda x: problem.residuals(names, x), prior.mean, prior, iterations)
    advance()
    problem = problem.with_residual_deviation(first.x)
    optima: list[Optimum] = []
    for start in (first.x, *(prior.mean + prior.deviation * rng.standard_normal((starts - 1, len(prior.mean))))):
        optima.append(search(lambda x: problem.residuals(names, x), start, prior, iterations))
        advance()
    optima.sort(key=lambda each: each.cost)
    left_out = _leave_one_out(problem, iterations, advance)
    motors = single_motors(problem, optima[0].x, left_out)
    advance()
    return Calibration(tuple(optima), _standard_error(problem, optima[0], left_out), left_out, motors)


def num_searches(logs: int, starts: int) -> int:
    """Number of searches of a calibration."""
    return 1 + starts + (logs if logs > 1 else 0) + 1


def is_identifiable(unknown: Unknown, error: float) -> bool:
    """Whether the logs halve the variance of a constant."""
    return error**2 < IDENTIFIABLE * unknown.deviation**2


def calibrated_fleet(problem: FleetProblem, found: Calibration) -> Fleet:
    """The fleet with its fitted constants; all others stay."""
    parameters = dict(problem.fleet.parameters)
    for unknown, x, error in zip(problem.unknowns, found.center, found.error, strict=True):
        spread = found.motors.spread.get(unknown.name, unknown.spread)
        values = {"center": unknown.value(x), "spread": spread, "center_uncertainty": float(error)}
        if not unknown.is_log:
            values["minimum"] = unknown.minimum
        rounded = {key: float(f"{value:.4g}") for key, value in values.items()}
        parameters[unknown.name] = Distribution("lognormal" if unknown.is_log else "normal", rounded)
    return replace(problem.fleet, name=f"{problem.fleet.name}_calibrated", parameters=parameters)


def _leave_one_out(problem: FleetProblem, iterations: int, advance: Callable[[], None]) -> dict[str, np.ndarray]:
    names, prior, found = list(problem.replayers), problem.prior, {}
    for name in names if len(names) > 1 else ():
        others = [other for other in names if other != name]
        fit = search(lambda x, others=others: problem.residuals(others, x), prior.mean, prior, iterations)
        found[name] = fit.x
        advance()
    return found


def _standard_error(problem: FleetProblem, best: Optimum, left_out: dict[str, np.ndarray]) -> np.ndarray:
    laplace = np.sqrt(np.diag(best.covariance(problem.prior)))
    if not left_out:
        return laplace
    # jackknife over n logs: variance (n-1)/n·Σ(x_i - mean)², x_i the fit without log i (Efron & Stein 1981)
    without = np.array(list(left_out.values()))
    jackknife = np.sqrt((len(without) - 1) * np.var(without, axis=0))
    return np.maximum(laplace, jackknife)


def single_motors(problem: FleetProblem, center: np.ndarray, left_out: Mapping[str, np.ndarray]) -> SingleMotors:
    """Fit offsets of single motors, linearly about the centre.

    Args:
        problem: fleet and logs.
        center: (unknowns,) fitted to all logs.
        left_out: log name -> (unknowns,) centre fitted without this log; empty for a single log.
    """
    differing = [problem.unknowns[i] for i in problem.differing]
    spread = np.tile([each.spread for each in differing], len(problem.joints))
    if not differing:
        return SingleMotors(spread, dict.fromkeys(left_out, spread), {})
    without = {name: _linear(problem, x, spread) for name, x in left_out.items()}
    multiple = _best_multiple(problem, left_out, without, spread) if without else 1.0
    linear, prior = list(_linear(problem, center, spread).values()), multiple * spread
    offsets, variance = _offsets(linear, prior), _variance(linear, prior)
    each_motor = (offsets**2 + variance).reshape(len(problem.joints), len(differing))
    between = np.maximum(np.sqrt(each_motor.mean(axis=0)), _MIN_SPREAD).tolist()
    found = {each.name: s for each, s in zip(differing, between, strict=True)}
    return SingleMotors(offsets, {name: _from_others(name, each, prior) for name, each in without.items()}, found)


def _linear(problem: FleetProblem, center: np.ndarray, spread: np.ndarray) -> dict[str, Linear]:
    at_center = np.zeros_like(spread)

    def residuals(name: str) -> Residuals:
        return lambda offsets: problem.residuals([name], center, offsets)

    names = problem.replayers
    return {name: (residuals(name)(at_center), jacobian(residuals(name), at_center, spread)) for name in names}


def _offsets(linear: Sequence[Linear], spread: np.ndarray) -> np.ndarray:
    error, slope = (np.concatenate(parts) for parts in zip(*linear, strict=True))
    start = np.zeros_like(spread)
    return gauss_newton_step(slope, error, start, GaussianPrior(start, spread, spread))


def _variance(linear: Sequence[Linear], spread: np.ndarray) -> np.ndarray:
    information = sum(slope.T @ slope for _, slope in linear)
    return np.diag(np.linalg.inv(information + np.diag(spread**-2)))


def _from_others(name: str, linear: Mapping[str, Linear], spread: np.ndarray) -> np.ndarray:
    """Offsets fitted to all logs but ``name``."""
    return _offsets([each for other, each in linear.items() if other != name], spread)


def _best_multiple(
    problem: FleetProblem,
    left_out: Mapping[str, np.ndarray],
    without: Mapping[str, Mapping[str, Linear]],
    spread: np.ndarray,
) -> float:
    def error(multiple: float) -> float:
        return sum(
            problem.rmse(name, left_out[name], _from_others(name, linear, multiple * spread))
            for name, linear in without.items()
        )

    return min(_SPREAD_MULTIPLES, key=error)
