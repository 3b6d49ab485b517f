"""A fleet fitted to real logs: its centre with its uncertainty, several optima, and the spread between motors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from motorprior.bench.distribution import Distribution
from motorprior.bench.fleet import Fleet
from motorprior.transfer.fleet_problem import FleetProblem, Unknown
from motorprior.transfer.gauss_newton import Optimum, search
from motorprior.transfer.single_motors import SingleMotors, single_motors

IDENTIFIED = 0.5
"""A constant is identified if its variance after the fit is below this share of the belief's."""


@dataclass(frozen=True)
class Calibration:
    """What the logs say of a fleet.

    Attributes:
        optima: where the searches from several starts ended, the best first.
        error: (unknowns,) standard error of the best: the larger of Laplace's and, of several logs, the jackknife's.
        left_out: (unknowns,) centre of the fit without a log, by that log's name; empty for a single log.
        motors: single ones about the best, and the spread between them.
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
        starts: searches; the first begins at the fleet's centre, and then again with the deviation that it left, the
            others at draws from the belief.
        iterations: of each search, at most.
        seed: of the draws.
        advance: called once per search, `searches` times in all.
    """
    names, belief, rng = list(problem.replayers), problem.belief, np.random.default_rng(seed)
    first = search(lambda x: problem.residuals(names, x), belief.mean, belief, iterations)
    advance()
    problem = problem.as_good_as(first.x)
    optima: list[Optimum] = []
    for start in (first.x, *(belief.mean + belief.deviation * rng.standard_normal((starts - 1, len(belief.mean))))):
        optima.append(search(lambda x: problem.residuals(names, x), start, belief, iterations))
        advance()
    optima.sort(key=lambda each: each.cost)
    left_out = _leave_one_out(problem, iterations, advance)
    motors = single_motors(problem, optima[0].x, left_out)
    advance()
    return Calibration(tuple(optima), _standard_error(problem, optima[0], left_out), left_out, motors)


def searches(logs: int, starts: int) -> int:
    """Number of searches of a calibration."""
    return 1 + starts + (logs if logs > 1 else 0) + 1


def _leave_one_out(problem: FleetProblem, iterations: int, advance: Callable[[], None]) -> dict[str, np.ndarray]:
    names, found = list(problem.replayers), {}
    for name in names if len(names) > 1 else ():
        others = [other for other in names if other != name]
        fit = search(
            lambda x, others=others: problem.residuals(others, x), problem.belief.mean, problem.belief, iterations
        )
        found[name] = fit.x
        advance()
    return found


def _standard_error(problem: FleetProblem, best: Optimum, left_out: dict[str, np.ndarray]) -> np.ndarray:
    """Jackknife over n logs: variance (n-1)/n·Σ(x_i - mean)², x_i the fit without log i (Efron & Stein 1981)."""
    laplace = np.sqrt(np.diag(best.covariance(problem.belief)))
    if not left_out:
        return laplace
    without = np.array(list(left_out.values()))
    jackknife = np.sqrt((len(without) - 1) * np.var(without, axis=0))
    return np.maximum(laplace, jackknife)


def is_identified(unknown: Unknown, error: float) -> bool:
    """Whether the logs say more of a constant than the belief did."""
    return error**2 < IDENTIFIED * unknown.deviation**2


def calibrated_fleet(problem: FleetProblem, found: Calibration) -> Fleet:
    """The fleet that the logs speak for: fitted constants anew, all others as they were."""
    parameters = dict(problem.fleet.parameters)
    for unknown, x, error in zip(problem.unknowns, found.center, found.error, strict=True):
        spread = found.motors.spread.get(unknown.name, unknown.spread)
        values = {"center": unknown.value(x), "spread": spread, "center_uncertainty": float(error)}
        if not unknown.is_log:
            values["minimum"] = unknown.least
        rounded = {key: float(f"{value:.4g}") for key, value in values.items()}
        parameters[unknown.name] = Distribution("lognormal" if unknown.is_log else "normal", rounded)
    return replace(problem.fleet, name=f"{problem.fleet.name}_calibrated", parameters=parameters)
