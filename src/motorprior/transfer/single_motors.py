"""Single motors about a fleet's centre: how far they differ, as far as other logs of the same motors bear it out.

Offsets y of the motors from the centre have the belief N(0, s²), s the spread between motors. About the centre the
residuals are r + J·y. A wide belief explains the logs it is fitted to by whatever the model lacks, so s is chosen by
leave-one-log-out: the multiple of the starting fleet's spread whose offsets, fitted to the other logs, leave the least
Σ (r + J·y)² in the log left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.identification.gauss_newton import Belief, gauss_newton_step, jacobian
from motorprior.transfer.fleet_problem import FleetProblem

MULTIPLES = (0.25, 0.5, 1.0, 2.0, 3.0)
"""Of the starting fleet's spread."""


@dataclass(frozen=True)
class SingleMotors:
    """Motors apart.

    Attributes:
        offsets: (moved joints · differing unknowns,) from the centre, see `FleetProblem.motors`.
        left_out: the same without a log, by that log's name; empty for a single log.
        spread: between motors, by name of the constant; empty where the fleet has no spread.
    """

    offsets: np.ndarray
    left_out: dict[str, np.ndarray]
    spread: dict[str, float]


def single_motors(problem: FleetProblem, center: np.ndarray) -> SingleMotors:
    """Fit the motors of the joints that moved, linearly about the centre (unknowns,)."""
    names, differing = list(problem.replayers), [problem.unknowns[i] for i in problem.differing]
    spread = np.tile([each.spread for each in differing], len(problem.joints))
    if not differing:
        return SingleMotors(spread, dict.fromkeys(names, spread) if len(names) > 1 else {}, {})
    scale = problem.scale(problem.residuals(names, center))
    linear = [_linear(problem, name, center, spread, scale) for name in names]
    multiple, left_out = 1.0, {}
    if len(names) > 1:
        multiple = min(MULTIPLES, key=lambda each: _misfit_left_out(linear, each * spread))
        left_out = dict(zip(names, _without_each(linear, multiple * spread), strict=True))
    found = {each.name: multiple * each.spread for each in differing}
    return SingleMotors(_offsets(linear, multiple * spread), left_out, found)


def _linear(
    problem: FleetProblem, name: str, center: np.ndarray, spread: np.ndarray, scale: float
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals r (N,) of one log at the centre and their slope J (N, offsets), in units of what the centre leaves."""

    def residuals(offsets: np.ndarray) -> np.ndarray:
        return problem.residuals([name], center, offsets) / scale

    at_center = np.zeros_like(spread)
    return residuals(at_center), jacobian(residuals, at_center, spread)


def _offsets(linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> np.ndarray:
    error, slope = (np.concatenate(parts) for parts in zip(*linear, strict=True))
    start = np.zeros_like(spread)
    return gauss_newton_step(slope, error, start, Belief(start, spread, spread))


def _without_each(linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> list[np.ndarray]:
    return [_offsets([*linear[:i], *linear[i + 1 :]], spread) for i in range(len(linear))]


def _misfit_left_out(linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> float:
    fits = zip(linear, _without_each(linear, spread), strict=True)
    return sum(float(np.sum((error + slope @ offsets) ** 2)) for (error, slope), offsets in fits)
