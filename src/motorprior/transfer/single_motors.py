"""Single motors about a fleet's centre: how far they differ, as far as other logs of the same motors bear it out.

Offsets y of the motors from the centre have the belief N(0, s²), s the spread between motors. About the centre the
residuals are r + J·y. A wide belief explains the logs it is fitted to by whatever the model lacks, so s is chosen by
leave-one-log-out: the multiple of the starting fleet's spread with the least error in the replay of the log left out,
mean over the logs; centre and offsets are then both fitted to the others. The spread is that of the motors found: the
root of the mean of y² and of its variance (one step of expectation and maximisation).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from motorprior.transfer.fleet_problem import FleetProblem
from motorprior.transfer.gauss_newton import Belief, Residuals, gauss_newton_step, jacobian

MULTIPLES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""Of the starting fleet's spread, among which the belief's is chosen."""
_LEAST_SPREAD = 0.01
"""No two motors are more alike, as a share."""


Linear: TypeAlias = tuple[np.ndarray, np.ndarray]
"""Residuals r (N,) of a log at a centre, and their slope J (N, offsets)."""


@dataclass(frozen=True)
class SingleMotors:
    """Motors apart.

    Attributes:
        offsets: (moved joints · differing unknowns,) from the centre, see `FleetProblem.motors`.
        left_out: the same from the centre without a log, fitted without it, by its name; empty for a single log.
        spread: between motors, by name of the constant; empty where the fleet has no spread.
    """

    offsets: np.ndarray
    left_out: dict[str, np.ndarray]
    spread: dict[str, float]


def single_motors(problem: FleetProblem, center: np.ndarray, left_out: Mapping[str, np.ndarray]) -> SingleMotors:
    """Fit the motors of the joints that moved, linearly about the centre.

    Args:
        problem: fleet and logs.
        center: (unknowns,) of all logs.
        left_out: (unknowns,) of all logs but one, by that log's name; empty for a single log.
    """
    differing = [problem.unknowns[i] for i in problem.differing]
    spread = np.tile([each.spread for each in differing], len(problem.joints))
    if not differing:
        return SingleMotors(spread, dict.fromkeys(left_out, spread), {})
    without = {name: _linear(problem, x, spread) for name, x in left_out.items()}
    multiple = _best_multiple(problem, left_out, without, spread) if without else 1.0
    linear, belief = list(_linear(problem, center, spread).values()), multiple * spread
    offsets, variance = _offsets(linear, belief), _variance(linear, belief)
    each_motor = (offsets**2 + variance).reshape(len(problem.joints), len(differing))
    between = np.maximum(np.sqrt(each_motor.mean(axis=0)), _LEAST_SPREAD).tolist()
    found = {each.name: s for each, s in zip(differing, between, strict=True)}
    return SingleMotors(offsets, {name: _others(name, each, belief) for name, each in without.items()}, found)


def _linear(problem: FleetProblem, center: np.ndarray, spread: np.ndarray) -> dict[str, Linear]:
    """Of every log about a centre."""
    at_center = np.zeros_like(spread)

    def residuals(name: str) -> Residuals:
        return lambda offsets: problem.residuals([name], center, offsets)

    names = problem.replayers
    return {name: (residuals(name)(at_center), jacobian(residuals(name), at_center, spread)) for name in names}


def _offsets(linear: Sequence[Linear], spread: np.ndarray) -> np.ndarray:
    error, slope = (np.concatenate(parts) for parts in zip(*linear, strict=True))
    start = np.zeros_like(spread)
    return gauss_newton_step(slope, error, start, Belief(start, spread, spread))


def _variance(linear: Sequence[Linear], spread: np.ndarray) -> np.ndarray:
    information = sum(slope.T @ slope for _, slope in linear)
    return np.diag(np.linalg.inv(information + np.diag(spread**-2)))


def _others(name: str, linear: Mapping[str, Linear], spread: np.ndarray) -> np.ndarray:
    """Offsets fitted to all logs but ``name``."""
    return _offsets([each for other, each in linear.items() if other != name], spread)


def _best_multiple(
    problem: FleetProblem,
    left_out: Mapping[str, np.ndarray],
    without: Mapping[str, Mapping[str, Linear]],
    spread: np.ndarray,
) -> float:
    """The multiple that serves the logs left out best."""

    def error(multiple: float) -> float:
        return sum(
            problem.rmse(name, left_out[name], _others(name, linear, multiple * spread))
            for name, linear in without.items()
        )

    return min(MULTIPLES, key=error)
