"""Single motors about a fleet's centre: how far they differ, as far as other logs of the same motors bear it out.

Offsets y of the motors from the centre have the belief N(0, s²), s the spread between motors. About the centre the
residuals are r + J·y. A wide belief explains the logs it is fitted to by whatever the model lacks, so s is chosen by
leave-one-log-out: the widest multiple of the starting fleet's spread whose offsets, fitted to the other logs, leave no
more error in the log left out, on average over the logs, than the central motor does. The spread is then that of the
motors found: the root of the mean of y² and of its variance (one step of expectation and maximisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.identification.gauss_newton import Belief, gauss_newton_step, jacobian
from motorprior.transfer.fleet_problem import FleetProblem

MULTIPLES = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
"""Of the starting fleet's spread, among which the belief's is chosen."""
_LEAST_SPREAD = 0.01
"""No two motors are more alike, as a share."""


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
    linear = [_linear(problem, name, center, spread) for name in names]
    multiple, left_out = 1.0, {}
    if len(names) > 1:
        multiple = _widest(problem, linear, spread)
        left_out = dict(zip(names, _without_each(linear, multiple * spread), strict=True))
    offsets, variance = _offsets(linear, multiple * spread), _variance(linear, multiple * spread)
    each_motor = (offsets**2 + variance).reshape(len(problem.joints), len(differing))
    between = np.maximum(np.sqrt(each_motor.mean(axis=0)), _LEAST_SPREAD).tolist()
    return SingleMotors(offsets, left_out, {each.name: s for each, s in zip(differing, between, strict=True)})


def _linear(problem: FleetProblem, name: str, center: np.ndarray, spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals r (N,) of one log at the centre and their slope J (N, offsets)."""

    def residuals(offsets: np.ndarray) -> np.ndarray:
        return problem.residuals([name], center, offsets)

    at_center = np.zeros_like(spread)
    return residuals(at_center), jacobian(residuals, at_center, spread)


def _offsets(linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> np.ndarray:
    error, slope = (np.concatenate(parts) for parts in zip(*linear, strict=True))
    start = np.zeros_like(spread)
    return gauss_newton_step(slope, error, start, Belief(start, spread, spread))


def _variance(linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> np.ndarray:
    information = sum(slope.T @ slope for _, slope in linear)
    return np.diag(np.linalg.inv(information + np.diag(spread**-2)))


def _without_each(linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> list[np.ndarray]:
    return [_offsets([*linear[:i], *linear[i + 1 :]], spread) for i in range(len(linear))]


def _widest(problem: FleetProblem, linear: Sequence[tuple[np.ndarray, np.ndarray]], spread: np.ndarray) -> float:
    """The multiple that the logs left out bear; the least one if none."""
    joints = [len(replayer.excited) for replayer in problem.replayers.values()]

    def error(fits: list[np.ndarray]) -> float:
        left = zip(linear, fits, joints, strict=True)
        return sum(float(np.linalg.norm(r + slope @ offsets) / np.sqrt(count)) for (r, slope), offsets, count in left)

    of_the_center = error([np.zeros_like(spread)] * len(linear))
    borne = [each for each in MULTIPLES if error(_without_each(linear, each * spread)) <= of_the_center]
    return max(borne, default=MULTIPLES[0])
