"""Response models of the closed loop, from the command to the motion of one joint, and their fit.

    pure_delay     q(t) = u(t - delay)
    second_order   q̈ = rate²·(u(t - delay) + offset - q) - 2·damping·rate·q̇
    servo_limits   e = gain·u(t - delay) + offset + compliance·τ + sine·sin q + cosine·cos q - q
                   q̈ = rate²·(e less the dead band) - 2·damping·rate·q̇,   |q̈| <= acceleration,  |q̇| <= speed

They need neither torque nor inertia, and hold for these gains and this load only. u [rad] is the
command, linear in time between two rows. "e less the dead band" is sign(e)·max(0, |e| - band). τ
[N·m] is the log's external torque at the simulated angle; ``compliance`` [rad/(N·m)] is that of a
proportional control law. If a log has no load, ``sine`` and ``cosine`` [rad] of the joint's own
angle replace it.

The fit is joint by joint, by the search of the motors' own fit: unknowns are logarithms of positive
constants within BOUNDS, and others in UNITS around their neutral values. Every model starts at the
optimum of the simpler one. An optional part of servo_limits is dropped if it saves less than
MIN_SAVING of the loss: a limit that the log barely reaches would bind in other motions. Logged
firmware registers are not searched.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from motorprior.compiled import njit
from motorprior.identification.physics.window_runs import WindowRuns, whole_runs
from motorprior.identification.presets import Recipe
from motorprior.identification.search import (
    FIXED,
    NARROW,
    WIDE,
    Fit,
    GaussianPrior,
    Search,
    threads,
)
from motorprior.identification.windows import EXTERNAL, POS, READING, STIFFNESS, TARGET, VEL
from motorprior.logs.loads import with_placeholder_load
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import Progress

INFINITE_RATE = 1e9  # rate from which the joint follows without lag
# constants in SI units with their neutral values
RESPONSE_CONSTANTS = {
    "delay": 0.0, "rate": INFINITE_RATE, "damping": 1.0, "speed": 1e9, "acceleration": 1e12, "band": 0.0, "gain": 1.0,
    "offset": 0.0, "compliance": 0.0, "sine": 0.0, "cosine": 0.0,
}  # fmt: skip
# constants of each model; servo_limits also has those of one of GRAVITY_TERMS
MODELS = {
    "pure_delay": ("delay",),
    "second_order": ("delay", "rate", "damping", "offset"),
    "servo_limits": ("delay", "rate", "damping", "speed", "acceleration", "band", "gain", "offset"),
}
# model of gravity: by the log's external torque, or by the joint's angle
GRAVITY_TERMS = {"torque": ("compliance",), "angle": ("sine", "cosine")}
# bounds [SI] of candidates of constants that are searched as logarithms
BOUNDS = {
    "delay": (1e-4, 0.4), "rate": (2.0, 600.0), "damping": (0.05, 20.0), "speed": (0.05, 100.0),
    "acceleration": (0.5, 1e5), "band": (1e-5, 0.3), "compliance": (1e-4, 10.0),
}  # fmt: skip
# units of constants that are searched linearly, within REACHABLE units of their neutral values
UNITS = {"gain": 0.15, "offset": 0.1, "sine": 0.1, "cosine": 0.1}
REACHABLE = 3.0
# dropped in this order
OPTIONAL = (("speed",), ("acceleration",), ("band",), ("gain",), *GRAVITY_TERMS.values())
# constants of servo_limits that are registers of a firmware (`MotorLog.firmware`)
REGISTERS = {"speed": "profile_speed", "acceleration": "profile_acceleration", "band": "dead_zone"}
MIN_SAVING = 0.04  # share of the loss that an optional part must save
# approximate maximum number of residuals of a joint; if there are more, every n-th is used
MAX_SAMPLES = 40_000
# [rad] quadratic-to-linear transition of the loss; large, since tables have RMS errors
SCALE = 0.05
RESTARTS = 16  # maximum number per model
_CANDIDATES = 256
_STEPS = ((10, WIDE), (8, NARROW))
_WEAK = 1e-6  # precision of the prior that keeps unidentifiable constants in place
_STREAM = 73
_NEAR = 0.01  # share of the range of a search within which a constant is at its bound
_OFFSET = list(RESPONSE_CONSTANTS).index("offset")


@njit(cache=True, nogil=True)
def _respond(rows, first, constants, dt, out):
    """Fill out (runs, steps) with one joint's simulated minus recorded angles [rad] at the end of every step.

    ``rows`` are (channels of `windows`, R); the first run begins at row ``first``, constants are in
    the order of RESPONSE_CONSTANTS, dt [s]. The logged velocity at the start is that of half a
    period before.
    """
    target = rows[TARGET]
    external = rows[EXTERNAL]
    stiffness = rows[STIFFNESS]
    delay, rate, damping, speed, acceleration, band, gain, offset, compliance, sine, cosine = (
        constants
    )
    late = delay / dt
    at_once = rate >= INFINITE_RATE
    turned = sine != 0.0 or cosine != 0.0
    for run in range(out.shape[0]):
        start = first + run * out.shape[1]
        q = rows[POS, start]
        dq = rows[VEL, start]
        for step in range(out.shape[1]):
            row = start + step
            # without lag, the end of the step has the command of that time
            age = max(0.0, row + at_once - late)
            before = min(int(age), target.shape[0] - 2)
            command = target[before] + (age - before) * (target[before + 1] - target[before])
            aim = gain * command + offset + compliance * (external[row] + stiffness[row] * q)
            if turned:
                aim += sine * np.sin(q) + cosine * np.cos(q)
            if at_once:
                q = aim
            else:
                missing = max(0.0, abs(aim - q) - band)
                push = rate * rate * (missing if aim > q else -missing)
                # damping implicit: always stable
                change = (dq + dt * push) / (1.0 + 2.0 * damping * rate * dt) - dq
                change = min(dt * acceleration, max(-dt * acceleration, change))
                dq = min(speed, max(-speed, dq + change))
                q += dt * dq
            out[run, step] = q - rows[READING, row + 1]


@dataclass(frozen=True)
class ResponseMotors:
    """One response model per joint."""

    constants: np.ndarray  # (M, constants) in the order of RESPONSE_CONSTANTS

    def errors(self, runs: WindowRuns) -> np.ndarray:
        """(M, N, W) simulated minus recorded angles [rad] of the same free runs as for other models."""
        joints = zip(range(runs.num_motors), self.constants, strict=True)
        return np.stack([JointRuns(runs, joint).errors(constants) for joint, constants in joints])


class JointRuns:
    """Free runs of one joint of a log."""

    def __init__(self, runs: WindowRuns, joint: int):
        self._preset = runs.recipe
        self._segments = [
            (np.ascontiguousarray(each.rows[:, :, joint].T), each.windows) for each in runs.segments
        ]

    def errors(self, constants: np.ndarray) -> np.ndarray:
        """(N, W) simulated minus recorded angles [rad] with these ``constants``."""
        found = []
        recipe = self._preset
        for rows, windows in self._segments:
            found.append(np.empty((windows, recipe.window)))
            _respond(rows, recipe.history, constants, recipe.period, found[-1])
        return np.concatenate(found)


def fit_responses(
    runs: Sequence[WindowRuns],
    gravity: str,
    seed: int = 0,
    report: Callable[[], None] = lambda: None,
    firmware: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, ResponseMotors]:
    """Fit all MODELS to every joint of the logs; ``gravity`` is a key of GRAVITY_TERMS.

    ``runs`` are free runs, one per segment; ``seed`` is of the search; ``report`` is called
    RESTARTS times per model; ``firmware`` are logged registers, used by servo_limits; 0 is off.
    """
    given = {
        name: firmware[each] or RESPONSE_CONSTANTS[name]
        for name, each in REGISTERS.items()
        if each in firmware
    }
    found: dict[str, ResponseMotors] = {}
    simpler = np.tile(list(RESPONSE_CONSTANTS.values()), (runs[0].num_motors, 1))
    centres = _offsets(runs)
    for name, free in MODELS.items():
        base = dict(RESPONSE_CONSTANTS)
        optional = ()
        if name == "servo_limits":
            free = tuple(each for each in (*free, *GRAVITY_TERMS[gravity]) if each not in given)
            base = base | given
            optional = [dropped for dropped in OPTIONAL if set(dropped) & set(free)]
        problem = _ResponseProblem(runs, free, base, centres)
        simpler[:, _OFFSET] = np.where(simpler[:, _OFFSET] == 0.0, centres, simpler[:, _OFFSET])
        fit, prior = _searched(
            problem, problem.encoded(simpler), np.random.default_rng([seed, _STREAM]), report
        )
        for dropped in optional:
            fit, prior = _without(problem, fit, prior, np.isin(free, dropped))
        simpler = problem.constants(fit.x, np.arange(problem.count))
        found[name] = ResponseMotors(simpler)
    return found


def _offsets(runs: Sequence[WindowRuns]) -> np.ndarray:
    """(M,) medians of angle - command [rad]; 0 where the search reaches them from 0."""
    neutral = np.array(list(RESPONSE_CONSTANTS.values()))
    found = []
    for joint in range(runs[0].num_motors):
        errors = np.concatenate([JointRuns(each, joint).errors(neutral).ravel() for each in runs])
        found.append(-float(np.median(errors)))
    return np.where(np.abs(found) > 0.5 * REACHABLE * UNITS["offset"], found, 0.0)


def at_bounds(motors: ResponseMotors) -> dict[str, np.ndarray]:
    """Masks (M,) by name of the constants at a bound of the search or beyond, which are not the joint's."""
    found = {}
    for name, values in zip(RESPONSE_CONSTANTS, motors.constants.T, strict=True):
        if name in BOUNDS:
            share = np.log(np.maximum(values, 1e-12) / BOUNDS[name][0]) / np.log(
                BOUNDS[name][1] / BOUNDS[name][0]
            )
            found[name] = (values != RESPONSE_CONSTANTS[name]) & (
                (share < _NEAR) | (share > 1.0 - _NEAR)
            )
        elif name != "offset":  # it has no absolute bounds
            found[name] = (
                np.abs(values - RESPONSE_CONSTANTS[name]) > (1.0 - _NEAR) * REACHABLE * UNITS[name]
            )
    return found


class _ResponseProblem:
    """One response model per joint, see `search.Problem`; constants that are not free are those of ``base``.

    ``centres`` (M,) are the offsets about which offsets are searched [rad].
    """

    weight = 1.0
    observations = 1

    def __init__(
        self,
        runs: Sequence[WindowRuns],
        free: tuple[str, ...],
        base: Mapping[str, float],
        centres: np.ndarray,
    ):
        self.count = runs[0].num_motors
        self._free = free
        self._joints = [[JointRuns(each, joint) for each in runs] for joint in range(self.count)]
        self._base = base
        self._every = 1 + sum(each.windows * each.recipe.window for each in runs) // MAX_SAMPLES
        low = np.array([np.log(BOUNDS[name][0]) if name in BOUNDS else -REACHABLE for name in free])
        high = np.array([np.log(BOUNDS[name][1]) if name in BOUNDS else REACHABLE for name in free])
        away = centres[:, None] / UNITS["offset"] * (np.array(free) == "offset")
        # (M, K)
        self.low = low + away
        self.high = high + away
        # constants with which a part has no effect
        self.neutral = np.array(
            [
                np.log(max(RESPONSE_CONSTANTS[each], 1e-9)) if each in BOUNDS else 0.0
                for each in free
            ]
        )

    def constants(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, constants) in the order of RESPONSE_CONSTANTS of unknowns x (L, K)."""
        values = {name: np.full(len(x), value) for name, value in self._base.items()}
        for name, column in zip(self._free, x.T, strict=True):
            values[name] = (
                np.exp(column)
                if name in BOUNDS
                else RESPONSE_CONSTANTS[name] + UNITS[name] * column
            )
        return np.stack([values[name] for name in RESPONSE_CONSTANTS], axis=1)

    def encoded(self, constants: np.ndarray) -> np.ndarray:
        """(M, K) unknowns of constants (M, constants), within the bounds."""
        values = dict(zip(RESPONSE_CONSTANTS, constants.T, strict=True))
        columns = [
            np.log(np.clip(values[name], *BOUNDS[name]))
            if name in BOUNDS
            else (values[name] - RESPONSE_CONSTANTS[name]) / UNITS[name]
            for name in self._free
        ]
        return np.stack(columns, axis=1)

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, samples) errors of angles over SCALE."""

        def errors(constants: np.ndarray, joint: int) -> np.ndarray:
            found = [runs.errors(constants).ravel() for runs in self._joints[joint]]
            return (np.concatenate(found)[:: self._every] / SCALE).astype(np.float32)

        return np.stack(list(threads().map(errors, self.constants(x, which), which)))


def _searched(
    problem: _ResponseProblem,
    start: np.ndarray,
    rng: np.random.Generator,
    report: Callable[[], None],
) -> tuple[Fit, GaussianPrior]:
    shape = (problem.count, _CANDIDATES, start.shape[1])
    low = problem.low[:, None]
    high = problem.high[:, None]

    def draw(restart: int, best: Fit) -> np.ndarray:
        anywhere = rng.uniform(low, high, shape)
        if restart % 3 == 0:
            return anywhere
        return np.where(rng.random(shape) < 0.5, anywhere, np.clip(best.x[:, None], low, high))

    search = Search(problem)
    prior = GaussianPrior(start, np.full(start.shape, _WEAK))
    found = search.descend(start, prior, _STEPS)
    return search.until_found_again(found, prior, draw, RESTARTS, _STEPS, report), prior


def _without(
    problem: _ResponseProblem, fit: Fit, prior: GaussianPrior, dropped: np.ndarray
) -> tuple[Fit, GaussianPrior]:
    """The fit with the ``dropped`` (K,) unknowns neutral, for the joints where they save too little."""
    mean = np.where(dropped, problem.neutral, prior.mean)
    precision = np.where(dropped, FIXED, prior.precision)
    start = np.where(dropped, problem.neutral, fit.x)
    without = Search(problem).descend(start, GaussianPrior(mean, precision), _STEPS)
    useless = without.loss * (1.0 - MIN_SAVING) < fit.loss
    pairs = (mean, prior.mean), (precision, prior.precision)
    chosen = np.flatnonzero(useless)
    return fit.replaced(chosen, without.subset(chosen)), GaussianPrior(
        *(np.where(useless[:, None], *x) for x in pairs)
    )


def fitted_responses(
    log: MotorLog, recipe: Recipe, seed: int, progress: Progress
) -> dict[str, ResponseMotors]:
    """Fit MODELS to a log; without loads, a function of the joint's angle represents gravity."""
    gravity = "angle" if log.external_torque is None else "torque"
    runs = whole_runs(with_placeholder_load(log), recipe)
    with progress.start("fit responses that need no load", len(MODELS) * RESTARTS) as task:
        return fit_responses(runs, gravity, seed, task.advance, log.firmware)
