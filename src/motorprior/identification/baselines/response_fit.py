"""Fit of the response models to logs, joint by joint: differential evolution, then bounded least squares.

    minimise  Σ (simulated - recorded angle)²   over free runs of whole segments

Every model begins where the simpler one ended as well. What servo_limits has beyond it is left out again, one after
another, where the error without it is not PRICE larger: a limit that motors hardly reached would bind where they go
beyond it. What the firmware was told (TOLD) is not searched. Constants that are positive are searched as logarithms.
Jacobians are central differences, wide and then narrow, since dead bands and limits have corners.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution, least_squares

from motorprior.identification.baselines.response_models import CONSTANTS, GRAVITY, MODELS, JointRuns, ResponseMotors
from motorprior.identification.physics.window_runs import WindowRuns

# Of constants that are searched as logarithms, in SI units
BOUNDS = {
    "delay": (1e-4, 0.4), "rate": (2.0, 600.0), "damping": (0.05, 20.0), "speed": (0.05, 100.0),
    "acceleration": (0.5, 1e5), "band": (1e-5, 0.3),
}  # fmt: skip
# One unit of the search, of constants that are searched as they are: REACHABLE units on both sides of nothing
UNITS = {"gain": 0.15, "offset": 0.1, "sag": 0.1, "sine": 0.1, "cosine": 0.1}
REACHABLE = 3.0
# Constants of servo_limits that are left out together, in this order
OPTIONAL = (("speed",), ("acceleration",), ("band",), ("gain",), *GRAVITY.values())
# Constants of servo_limits that are registers of a firmware (`MotorLog.firmware`)
TOLD = {"speed": "profile_speed", "acceleration": "profile_acceleration", "band": "dead_zone"}
GENERATIONS, POPULATION = 60, 8  # Of the differential evolution per joint and model; the latter for each constant
EVALUATIONS = 60  # Most steps of a polish
REACHES = (0.05, 0.005)  # Half the distance of two simulations that give a derivative, first and then
PRICE = 0.04  # Share of the squared error that a constant must save
LONGEST = 40_000  # About as many samples of a joint make the residuals; of more, every n-th


def fit_responses(
    runs: Sequence[WindowRuns],
    gravity: str,
    seed: int = 0,
    report: Callable[[], None] = lambda: None,
    firmware: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, ResponseMotors]:
    """All of MODELS, fitted to every joint of the logs.

    Args:
        runs: free runs, one per segment of the logs.
        gravity: of GRAVITY: what stands for gravity in servo_limits.
        seed: of the global search.
        report: called after every joint.
        firmware: registers that servo_limits is told; one that is 0 is off.
    """
    told = {name: firmware[each] or CONSTANTS[name] for name, each in TOLD.items() if each in firmware}
    joints = runs[0].num_motors
    found = {name: np.empty((joints, len(CONSTANTS))) for name in MODELS}
    for joint in range(joints):
        simpler = np.array(list(CONSTANTS.values()))
        for name, constants in MODELS.items():
            free, base = constants, dict(CONSTANTS)
            if name == "servo_limits":
                free, base = tuple(each for each in (*free, *GRAVITY[gravity]) if each not in told), base | told
            rng = np.random.default_rng([seed, joint, len(free)])
            cost, full = _JointFit(runs, joint, free, base).best(simpler, rng)
            for optional in OPTIONAL if name == "servo_limits" else ():
                cost, full, free = _without(runs, joint, optional, cost, full, free, base)
            found[name][joint] = simpler = full
        report()
    return {name: ResponseMotors(name, constants) for name, constants in found.items()}


def _without(
    runs: Sequence[WindowRuns],
    joint: int,
    optional: tuple[str, ...],
    cost: float,
    full: np.ndarray,
    free: tuple[str, ...],
    base: Mapping[str, float],
) -> tuple[float, np.ndarray, tuple[str, ...]]:
    """Cost, constants and names of a fit, less those that are ``optional`` if they are not worth their price."""
    fewer = tuple(name for name in free if name not in optional)
    if fewer == free:
        return cost, full, free
    less, constants = _JointFit(runs, joint, fewer, base).polished(full)
    return (less, constants, fewer) if less * (1.0 - PRICE) < cost else (cost, full, free)


class _JointFit:
    """The least-squares problem of one joint and one model, over x: logarithms, or units; others are as in ``base``."""

    def __init__(self, runs: Sequence[WindowRuns], joint: int, free: tuple[str, ...], base: Mapping[str, float]):
        self._runs, self._free = [JointRuns(each, joint) for each in runs], free
        self._base = np.array([base[name] for name in CONSTANTS])
        self._columns = [list(CONSTANTS).index(name) for name in free]
        self._every = 1 + sum(each.windows * each.preset.window for each in runs) // LONGEST
        self.low = np.array([np.log(BOUNDS[name][0]) if name in BOUNDS else -REACHABLE for name in free])
        self.high = np.array([np.log(BOUNDS[name][1]) if name in BOUNDS else REACHABLE for name in free])

    def best(self, simpler: np.ndarray, rng: np.random.Generator) -> tuple[float, np.ndarray]:
        """Cost and constants of the least error, of a search that also begins at those of a ``simpler`` model."""
        known = self._encoded(simpler)
        found = differential_evolution(
            lambda x: float(np.mean(self._residuals(x) ** 2)), list(zip(self.low, self.high, strict=True)),
            x0=np.clip(known, self.low, self.high), maxiter=GENERATIONS, popsize=POPULATION, init="sobol", polish=False,
            tol=1e-3, rng=rng,
        )  # fmt: skip
        polished = [self._polished(start) for start in (found.x, known)]
        cost, x = min(polished, key=lambda found: found[0])
        return cost, self._decoded(x)

    def polished(self, start: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and constants of a fit that begins at these constants."""
        cost, x = self._polished(self._encoded(start))
        return cost, self._decoded(x)

    def _polished(self, start: np.ndarray) -> tuple[float, np.ndarray]:
        x, cost = start, np.inf
        for reach in REACHES:
            inside = np.clip(x, self.low + 1e-6, self.high - 1e-6)
            slopes: Any = partial(self._slopes, reach=reach)
            found = least_squares(
                self._residuals, inside, slopes, (self.low, self.high), x_scale="jac", max_nfev=EVALUATIONS,
                ftol=1e-6, xtol=1e-7,
            )  # fmt: skip
            x, cost = found.x, float(found.cost)
        return cost, x

    def _residuals(self, x: np.ndarray) -> np.ndarray:
        constants = self._decoded(x)
        found = [runs.errors(constants).ravel() for runs in self._runs]
        return np.concatenate(found)[:: self._every]

    def _slopes(self, x: np.ndarray, reach: float) -> np.ndarray:
        shifts = reach * np.eye(len(x))
        return np.stack([(self._residuals(x + s) - self._residuals(x - s)) / (2 * reach) for s in shifts], axis=1)

    def _encoded(self, constants: np.ndarray) -> np.ndarray:
        x = [
            np.log(np.clip(constants[column], *BOUNDS[name])) if name in BOUNDS
            else (constants[column] - CONSTANTS[name]) / UNITS[name]
            for name, column in zip(self._free, self._columns, strict=True)
        ]  # fmt: skip
        return np.array(x)

    def _decoded(self, x: np.ndarray) -> np.ndarray:
        constants = self._base.copy()
        for name, column, value in zip(self._free, self._columns, x, strict=True):
            constants[column] = np.exp(value) if name in BOUNDS else CONSTANTS[name] + UNITS[name] * value
        return constants
