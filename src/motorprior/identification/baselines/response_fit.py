"""Fit of the response models to logs, joint by joint: differential evolution, then bounded least squares.

    minimise  Σ (simulated - recorded angle)²   over free runs of whole segments

Every model also starts at the optimum of the simpler one. Each optional part of servo_limits is dropped if it saves
less than MIN_SAVING of the squared error: a limit that the log hardly reaches would bind in other motions. Logged
firmware registers are not searched. Positive constants are searched as logarithms. Jacobians are central differences,
first with a wide step, then with a narrow one, since dead bands and limits have corners.
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

# in SI units, of constants that are searched as logarithms
BOUNDS = {
    "delay": (1e-4, 0.4), "rate": (2.0, 600.0), "damping": (0.05, 20.0), "speed": (0.05, 100.0),
    "acceleration": (0.5, 1e5), "band": (1e-5, 0.3),
}  # fmt: skip
# units of constants that are searched linearly, within REACHABLE units of their neutral values
UNITS = {"gain": 0.15, "offset": 0.1, "compliance": 0.1, "sine": 0.1, "cosine": 0.1}
REACHABLE = 3.0
OPTIONAL = (("speed",), ("acceleration",), ("band",), ("gain",), *GRAVITY.values())  # dropped in this order
# constants of servo_limits that are registers of a firmware (`MotorLog.firmware`)
REGISTERS = {"speed": "profile_speed", "acceleration": "profile_acceleration", "band": "dead_zone"}
GENERATIONS, POPULATION = 60, 8  # of the differential evolution; the latter per constant
EVALUATIONS = 60  # maximum number of steps of a polish
DIFF_STEPS = (0.05, 0.005)  # difference steps, in the order of their use
MIN_SAVING = 0.04  # share of the squared error that an optional part must save
MAX_SAMPLES = 40_000  # approximate maximum number of residuals of a joint; if there are more, every n-th is used


def fit_responses(
    runs: Sequence[WindowRuns],
    gravity: str,
    seed: int = 0,
    report: Callable[[], None] = lambda: None,
    firmware: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, ResponseMotors]:
    """Fit all MODELS to every joint of the logs; ``gravity`` is a key of GRAVITY.

    ``runs`` are free runs, one per segment; ``seed`` is of the global search; ``report`` is called after each joint;
    ``firmware`` are logged registers, used by servo_limits; 0 is off.
    """
    given = {name: firmware[each] or CONSTANTS[name] for name, each in REGISTERS.items() if each in firmware}
    joints = runs[0].num_motors
    found = {name: np.empty((joints, len(CONSTANTS))) for name in MODELS}
    for joint in range(joints):
        simpler = np.array(list(CONSTANTS.values()))
        for name, free in MODELS.items():
            base, optional = dict(CONSTANTS), ()
            if name == "servo_limits":
                free, base = tuple(each for each in (*free, *GRAVITY[gravity]) if each not in given), base | given
                optional = OPTIONAL
            rng = np.random.default_rng([seed, joint, len(free)])
            cost, constants = _JointFit(runs, joint, free, base).best(simpler, rng)
            for dropped in optional:
                fewer = tuple(each for each in free if each not in dropped)
                if fewer == free:
                    continue
                fit = _JointFit(runs, joint, fewer, base)
                cost_without, without = fit.polished(fit.encoded(constants))
                if cost_without * (1.0 - MIN_SAVING) < cost:
                    cost, constants, free = cost_without, without, fewer
            found[name][joint] = simpler = constants
        report()
    return {name: ResponseMotors(name, constants) for name, constants in found.items()}


class _JointFit:
    """The least-squares problem of one joint and one model; constants that are not free are those of ``base``."""

    def __init__(self, runs: Sequence[WindowRuns], joint: int, free: tuple[str, ...], base: Mapping[str, float]):
        self._runs, self._free = [JointRuns(each, joint) for each in runs], free
        self._base = np.array([base[name] for name in CONSTANTS])
        self._columns = [list(CONSTANTS).index(name) for name in free]
        self._every = 1 + sum(each.windows * each.preset.window for each in runs) // MAX_SAMPLES
        self.low = np.array([np.log(BOUNDS[name][0]) if name in BOUNDS else -REACHABLE for name in free])
        self.high = np.array([np.log(BOUNDS[name][1]) if name in BOUNDS else REACHABLE for name in free])

    def best(self, simpler: np.ndarray, rng: np.random.Generator) -> tuple[float, np.ndarray]:
        """Cost and constants of a search that also starts at those of a ``simpler`` model."""
        start = self.encoded(simpler)
        found = differential_evolution(
            lambda x: float(np.mean(self._residuals(x) ** 2)), list(zip(self.low, self.high, strict=True)),
            x0=np.clip(start, self.low, self.high), maxiter=GENERATIONS, popsize=POPULATION, init="sobol", polish=False,
            tol=1e-3, rng=rng,
        )  # fmt: skip
        return min((self.polished(each) for each in (found.x, start)), key=lambda fit: fit[0])

    def polished(self, start: np.ndarray) -> tuple[float, np.ndarray]:
        """Cost and constants of a fit from these `encoded` constants."""
        x, cost = start, np.inf
        for diff_step in DIFF_STEPS:
            inside = np.clip(x, self.low + 1e-6, self.high - 1e-6)
            slopes: Any = partial(self._slopes, diff_step=diff_step)
            found = least_squares(
                self._residuals, inside, slopes, (self.low, self.high), x_scale="jac", max_nfev=EVALUATIONS,
                ftol=1e-6, xtol=1e-7,
            )  # fmt: skip
            x, cost = found.x, float(found.cost)
        return cost, self._decoded(x)

    def _residuals(self, x: np.ndarray) -> np.ndarray:
        constants = self._decoded(x)
        found = [runs.errors(constants).ravel() for runs in self._runs]
        return np.concatenate(found)[:: self._every]

    def _slopes(self, x: np.ndarray, diff_step: float) -> np.ndarray:
        shifts = diff_step * np.eye(len(x))
        return np.stack([(self._residuals(x + s) - self._residuals(x - s)) / (2 * diff_step) for s in shifts], axis=1)

    def encoded(self, constants: np.ndarray) -> np.ndarray:
        """Search variables of these constants."""
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
