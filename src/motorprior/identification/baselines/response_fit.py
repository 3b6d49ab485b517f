"""Response models of the closed loop, from the command to the motion of one joint, and their fit.

    pure_delay     q(t) = u(t - delay)
    second_order   q̈ = rate²·(u(t - delay) + offset - q) - 2·damping·rate·q̇
    servo_limits   e = gain·u(t - delay) + offset + compliance·τ + sine·sin q + cosine·cos q - q
                   q̈ = rate²·(e less the dead band) - 2·damping·rate·q̇
                   |q̈| <= acceleration,  |q̇| <= speed

They need neither torque nor inertia, and hold for these gains and this load only. u [rad] is the
command, linear in time between two rows. "e less the dead band" is sign(e)·max(0, |e| - band). τ
[N·m] is the log's external torque at the simulated angle; ``compliance`` [rad/(N·m)] is the
compliance of a proportional control law. If a log has no load, ``sine`` and ``cosine`` [rad] of the
joint's own angle replace it. In MIT mode, q̇ is relative to the velocity target in the damping, and
τ includes the feed-forward torque, both as late as u. Velocity and torque commands have no u.

The fit is joint by joint, by the search of the motors' own fit: unknowns are logarithms of positive
constants within BOUNDS, and others in UNITS around their neutral values. Every model starts at the
optimum of the simpler one. An optional effect of servo_limits is dropped if it saves less than
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
from motorprior.identification.windows import (
    CHANNELS,
    EXTERNAL,
    FEEDFORWARD,
    POS,
    READING,
    STIFFNESS,
    TARGET,
    VEL,
    VELOCITY_TARGET,
)
from motorprior.logs.command_modes import commands_angles
from motorprior.logs.loads import with_placeholder_load
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import Progress

INFINITE_RATE = 1e9  # rate from which the joint follows without lag
# constants in SI units with their neutral values
RESPONSE_CONSTANTS = {
    "delay": 0.0,
    "rate": INFINITE_RATE,
    "damping": 1.0,
    "speed": 1e9,
    "acceleration": 1e12,
    "band": 0.0,
    "gain": 1.0,
    "offset": 0.0,
    "compliance": 0.0,
    "sine": 0.0,
    "cosine": 0.0,
}
# constants of each model; servo_limits also has one of GRAVITY_TERMS
MODELS = {
    "pure_delay": ("delay",),
    "second_order": ("delay", "rate", "damping", "offset"),
    "servo_limits": ("delay", "rate", "damping", "speed", "acceleration", "band", "gain", "offset"),
}
# model of gravity: by the log's external torque, or by the joint's angle
GRAVITY_TERMS = {"torque": ("compliance",), "angle": ("sine", "cosine")}
# bounds [SI] of candidates of constants that are searched as logarithms
BOUNDS = {
    "delay": (1e-4, 0.4),
    "rate": (2.0, 600.0),
    "damping": (0.05, 20.0),
    "speed": (0.05, 100.0),
    "acceleration": (0.5, 1e5),
    "band": (1e-5, 0.3),
    "compliance": (1e-4, 10.0),
}
# units of constants that are searched linearly, within REACHABLE units of their neutral values
UNITS = {"gain": 0.15, "offset": 0.1, "sine": 0.1, "cosine": 0.1}
REACHABLE = 3.0
# optional effects, dropped in this order
OPTIONAL = (("speed",), ("acceleration",), ("band",), ("gain",), *GRAVITY_TERMS.values())
# constants of servo_limits that are registers of a firmware (`MotorLog.firmware`)
REGISTERS = {"speed": "profile_speed", "acceleration": "profile_acceleration", "band": "dead_zone"}
MIN_SAVING = 0.04  # share of the loss that an optional effect must save
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
    """Fill out (runs, steps) with simulated minus recorded angles [rad] at the end of every step.

    ``rows`` (channels of `windows`, R) belong to one joint; the first run begins at row ``first``.
    Constants are in the order of RESPONSE_CONSTANTS, dt is in [s]. The logged velocity at the start
    is half a period old.
    """
    target = rows[TARGET]
    external = rows[EXTERNAL]
    stiffness = rows[STIFFNESS]
    delay, rate, damping, speed, acceleration, band, gain, offset, compliance, sine, cosine = (
        constants
    )
    delay_steps = delay / dt
    at_once = rate >= INFINITE_RATE
    depends_on_angle = sine != 0.0 or cosine != 0.0
    has_frames = rows.shape[0] > CHANNELS
    reference_vel = 0.0
    feedforward = 0.0

    for run in range(out.shape[0]):
        start = first + run * out.shape[1]
        q = rows[POS, start]
        dq = rows[VEL, start]
        for step in range(out.shape[1]):
            row = start + step

            # the delayed command; without lag, the end of the step has the command of that time
            age = max(0.0, row + at_once - delay_steps)
            earlier = min(int(age), target.shape[0] - 2)
            command = target[earlier] + (age - earlier) * (target[earlier + 1] - target[earlier])
            if has_frames:
                reference_vel = rows[VELOCITY_TARGET, earlier]
                feedforward = rows[FEEDFORWARD, earlier]

            # the angle at which the joint would rest
            load = external[row] + stiffness[row] * q + feedforward
            aim = gain * command + offset + compliance * load
            if depends_on_angle:
                aim += sine * np.sin(q) + cosine * np.cos(q)

            if at_once:
                q = aim
            else:
                distance = max(0.0, abs(aim - q) - band)
                push = rate * rate * (distance if aim > q else -distance)
                push += 2.0 * damping * rate * reference_vel
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
        """(M, N, W) simulated minus recorded angles [rad] of the same free runs as other models."""
        errors = []
        for joint in range(runs.num_motors):
            errors.append(JointRuns(runs, joint).errors(self.constants[joint]))
        return np.stack(errors)


class JointRuns:
    """Free runs of one joint of a log."""

    def __init__(self, runs: WindowRuns, joint: int):
        self._recipe = runs.recipe
        self._segments = []
        for segment in runs.segments:
            rows = np.ascontiguousarray(segment.rows[:, :, joint].T)
            self._segments.append((rows, segment.windows))

    def errors(self, constants: np.ndarray) -> np.ndarray:
        """(N, W) simulated minus recorded angles [rad] with these ``constants``."""
        recipe = self._recipe
        errors = []
        for rows, windows in self._segments:
            out = np.empty((windows, recipe.window))
            _respond(rows, recipe.history, constants, recipe.period, out)
            errors.append(out)
        return np.concatenate(errors)


def fit_responses(
    runs: Sequence[WindowRuns],
    gravity: str,
    seed: int = 0,
    report: Callable[[], None] = lambda: None,
    firmware: Mapping[str, float] = MappingProxyType({}),
    restarts: int = RESTARTS,
) -> dict[str, ResponseMotors]:
    """Fit all MODELS to every joint of the logs.

    Args:
        runs: free runs, one per segment.
        gravity: key of GRAVITY_TERMS.
        seed: of the search.
        report: called ``restarts`` times per model.
        firmware: logged registers, used by servo_limits; 0 is off.
        restarts: maximum number of restarts of a search.
    """
    logged = {}
    for name, register in REGISTERS.items():
        if register in firmware:
            logged[name] = firmware[register] or RESPONSE_CONSTANTS[name]

    motors: dict[str, ResponseMotors] = {}
    constants = np.tile(list(RESPONSE_CONSTANTS.values()), (runs[0].num_motors, 1))
    centres = _offsets(runs)
    for name, free in MODELS.items():
        base = dict(RESPONSE_CONSTANTS)
        optional = []
        if name == "servo_limits":
            free = tuple(one for one in (*free, *GRAVITY_TERMS[gravity]) if one not in logged)
            base |= logged
            optional = [effect for effect in OPTIONAL if set(effect) & set(free)]

        # from the optimum of the simpler model
        problem = _ResponseProblem(runs, free, base, centres)
        offsets = constants[:, _OFFSET]
        constants[:, _OFFSET] = np.where(offsets == 0.0, centres, offsets)
        rng = np.random.default_rng([seed, _STREAM])
        fit, prior = _searched(problem, problem.encoded(constants), rng, restarts, report)
        for effect in optional:
            fit, prior = _without(problem, fit, prior, np.isin(free, effect))
        constants = problem.constants(fit.x, np.arange(problem.count))
        motors[name] = ResponseMotors(constants)
    return motors


def _offsets(runs: Sequence[WindowRuns]) -> np.ndarray:
    """(M,) medians of angle - command [rad]; 0 where the search reaches them from 0."""
    neutral = np.array(list(RESPONSE_CONSTANTS.values()))
    medians = []
    for joint in range(runs[0].num_motors):
        errors = [JointRuns(segment, joint).errors(neutral).ravel() for segment in runs]
        medians.append(-float(np.median(np.concatenate(errors))))
    is_far = np.abs(medians) > 0.5 * REACHABLE * UNITS["offset"]
    return np.where(is_far, medians, 0.0)


def at_bounds(motors: ResponseMotors) -> dict[str, np.ndarray]:
    """Masks (M,) by name of the constants at a bound of the search or beyond.

    Such a constant is the bound's, not the joint's.
    """
    masks = {}
    for name, values in zip(RESPONSE_CONSTANTS, motors.constants.T, strict=True):
        neutral = RESPONSE_CONSTANTS[name]
        if name in BOUNDS:
            low, high = BOUNDS[name]
            share = np.log(np.maximum(values, 1e-12) / low) / np.log(high / low)
            is_near = (share < _NEAR) | (share > 1.0 - _NEAR)
            masks[name] = (values != neutral) & is_near
        elif name != "offset":  # it has no absolute bounds
            reach = (1.0 - _NEAR) * REACHABLE * UNITS[name]
            masks[name] = np.abs(values - neutral) > reach
    return masks


class _ResponseProblem:
    """One response model per joint, see `search.Problem`.

    Constants that are not ``free`` have the values ``base``. ``centres`` (M,) are the offsets about
    which offsets are searched [rad].
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
        self._base = base
        self._joints = []
        for joint in range(self.count):
            self._joints.append([JointRuns(segment, joint) for segment in runs])
        samples = sum(segment.windows * segment.recipe.window for segment in runs)
        self._stride = 1 + samples // MAX_SAMPLES

        # (K,) bounds of the unknowns, and unknowns with which a constant has no effect
        low = []
        high = []
        neutral = []
        for name in free:
            if name in BOUNDS:
                low.append(np.log(BOUNDS[name][0]))
                high.append(np.log(BOUNDS[name][1]))
                neutral.append(np.log(max(RESPONSE_CONSTANTS[name], 1e-9)))
            else:
                low.append(-REACHABLE)
                high.append(REACHABLE)
                neutral.append(0.0)
        self.neutral = np.array(neutral)
        # (M, K) bounds of each joint
        shift = centres[:, None] / UNITS["offset"] * (np.array(free) == "offset")
        self.low = np.array(low) + shift
        self.high = np.array(high) + shift

    def constants(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, constants) in the order of RESPONSE_CONSTANTS of unknowns x (L, K)."""
        values = {name: np.full(len(x), value) for name, value in self._base.items()}
        for name, column in zip(self._free, x.T, strict=True):
            if name in BOUNDS:
                values[name] = np.exp(column)
            else:
                values[name] = RESPONSE_CONSTANTS[name] + UNITS[name] * column
        return np.stack([values[name] for name in RESPONSE_CONSTANTS], axis=1)

    def encoded(self, constants: np.ndarray) -> np.ndarray:
        """(M, K) unknowns of constants (M, constants), within the bounds."""
        values = dict(zip(RESPONSE_CONSTANTS, constants.T, strict=True))
        columns = []
        for name in self._free:
            if name in BOUNDS:
                columns.append(np.log(np.clip(values[name], *BOUNDS[name])))
            else:
                columns.append((values[name] - RESPONSE_CONSTANTS[name]) / UNITS[name])
        return np.stack(columns, axis=1)

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, samples) errors of angles of joint ``problems[l]`` over SCALE, at x (L, K)."""

        def errors_of(constants: np.ndarray, joint: int) -> np.ndarray:
            errors = [runs.errors(constants).ravel() for runs in self._joints[joint]]
            sampled = np.concatenate(errors)[:: self._stride]
            return (sampled / SCALE).astype(np.float32)

        constants = self.constants(x, problems)
        return np.stack(list(threads().map(errors_of, constants, problems)))


def _searched(
    problem: _ResponseProblem,
    start: np.ndarray,
    rng: np.random.Generator,
    restarts: int,
    report: Callable[[], None],
) -> tuple[Fit, GaussianPrior]:
    """Fit from ``start`` (M, K) and from random candidates, and its weak prior about ``start``."""
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
    first = search.descend(start, prior, _STEPS)
    return search.until_found_again(first, prior, draw, restarts, _STEPS, report), prior


def _without(
    problem: _ResponseProblem, fit: Fit, prior: GaussianPrior, dropped: np.ndarray
) -> tuple[Fit, GaussianPrior]:
    """Fit and prior with the ``dropped`` (K,) unknowns neutral, where these save too little.

    Every joint decides by itself.
    """
    mean = np.where(dropped, problem.neutral, prior.mean)
    precision = np.where(dropped, FIXED, prior.precision)
    start = np.where(dropped, problem.neutral, fit.x)
    without = Search(problem).descend(start, GaussianPrior(mean, precision), _STEPS)

    is_useless = without.loss * (1.0 - MIN_SAVING) < fit.loss
    joints = np.flatnonzero(is_useless)
    next_prior = GaussianPrior(
        np.where(is_useless[:, None], mean, prior.mean),
        np.where(is_useless[:, None], precision, prior.precision),
    )
    return fit.replaced(joints, without.subset(joints)), next_prior


def fitted_responses(
    log: MotorLog, recipe: Recipe, seed: int, progress: Progress
) -> dict[str, ResponseMotors]:
    """Fit MODELS to a log; without loads, a function of the joint's angle represents gravity.

    There are none unless position targets act on every joint, in every segment.
    """
    if not all(np.all(commands_angles(segment)) for segment in log.segments()):
        return {}
    gravity = "angle" if log.external_torque is None else "torque"
    runs = whole_runs(with_placeholder_load(log), recipe)
    with progress.start("fit responses that need no load", len(MODELS) * RESTARTS) as task:
        return fit_responses(runs, gravity, seed, task.advance, log.firmware)
