"""An unknown load, fitted together with its motor.

The load is a rigid body on the joint of a robot with a fixed base:

    load_inertia = J
    external_torque = -(s·sin q + c·cos q)
    load_stiffness = -(s·cos q - c·sin q)

q is the joint angle. Free runs of the grey box have three more latents: ln(J/J₀), s/g and c/g, with
g = 0.2 rad·kp (`kp_of_size`). Their prior is about a regression of the logged control law,

    kp·(position_target - q) + kd·velocity_target + torque_feedforward
        = J₀·q̈ + s₀·sin q + c₀·cos q + d·q̇ + f·sign q̇.

Gains must be logged in N·m/rad, or torques be commanded, since angles and other commands do not
identify the scale of torques.
Without play they identify only the sum of load inertia and armature, which the prior divides.
Standard deviations (Laplace) count the whole log as one observation: most of the residual is
missing physics, the same in every window.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.geared_motor_step import PARAMETERS, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import in_order
from motorprior.exceptions import LogError
from motorprior.identification import windows
from motorprior.identification.latents.latent_fit import inverse_precision
from motorprior.identification.physics.motor_problem import (
    MotorProblem,
    fixed_constants,
    grey_box,
    initial_center,
    kp_of_size,
)
from motorprior.identification.physics.term_selection import (
    MIN_VARIATION,
    terms_without_variation,
)
from motorprior.identification.physics.window_runs import (
    POSITION_SCALE,
    SegmentArrays,
    WindowRuns,
    grey_boxes,
)
from motorprior.identification.presets import PRESETS, with_logged_settings
from motorprior.identification.search import NARROW, WIDE, Fit, GaussianPrior, Search, threads
from motorprior.logs.motor_log import PHYSICAL_GAINS, POSTURES, MotorLog, checked, motor_logs
from motorprior.logs.operations import joined, smooth_on_grid, static_joints
from motorprior.progress import PYTHON_WARNINGS, Progress
from motorprior.signals import rms

RECIPE = PRESETS["pace_long_runs"]  # runs of a second, logged optional terms only
RESTARTS = 24  # maximum number per joint
_SAG = 0.2  # g over kp [rad]
_LOAD = 3  # latents of the load; they come last
_ROWS = 30_000  # approximate maximum number of fitted rows
# standard deviations of the candidates, in turn
_RADII = (1.0, 0.5, 0.35)
_CANDIDATES = 96
_STARTS = 3
_STEPS = ((10, WIDE), (6, NARROW))
# standard deviations of the prior: of a latent of the motor, of ln(J/J₀), of s/g and c/g
_STD_CONSTANT = 1.0
_STD_INERTIA = 2.0
_STD_GRAVITY = 1.0
_EXPECTED = 0.01  # loss after a fit over that before
_DIVERGED = 1e6  # loss of a simulation that diverges
_LANES = 32  # loads simulated at a time; each has its own rows
_STREAM = 61


@dataclass(frozen=True)
class FittedLoad:
    """Load of a joint."""

    inertia: float  # J [kg·m²]
    inertia_deviation: float  # standard deviation of ln J [-]
    armature_deviation: float  # standard deviation of the logarithm of the motor's armature [-]
    gravity: np.ndarray  # (2,) s and c [N·m]
    gravity_covariance: np.ndarray  # (2, 2) of s and c [N²·m²]
    error: float  # root mean square of the residual position error [rad]

    def __str__(self) -> str:
        # W·sin(q - h) = s·sin q + c·cos q with W = √(s² + c²), whose deviation is that along (s, c)
        weight = float(np.hypot(*self.gravity))
        along = self.gravity / max(weight, 1e-12)
        std = float(np.sqrt(along @ self.gravity_covariance @ along))
        weight_text = f"below {weight + 2.0 * std:.1g} N·m"
        if weight > 2.0 * std:
            weight_text = f"{weight:.2g} ± {std:.1g} N·m"

        inertia_factor = np.exp(self.inertia_deviation)
        armature_factor = np.exp(self.armature_deviation)
        factors = f"1 σ ×/÷ {inertia_factor:.2f}, of the armature {armature_factor:.2f}"
        return (
            f"inertia {self.inertia:.2g} kg·m² ({factors}); weight {weight_text}; "
            f"residual {1e3 * self.error:.1f} mrad"
        )


class _LoadProblem(MotorProblem):
    """Free runs of one joint; the last unknowns belong to its load.

    Attributes:
        start: (3,) J₀ [kg·m²], s₀ and c₀ [N·m].
        unit: g [N·m].
    """

    def __init__(self, model: GreyBox, runs: WindowRuns):
        super().__init__(model, runs)
        self.start = _regression(runs)
        self.unit = _SAG * kp_of_size(runs)

    def load(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(L,) inertia [kg·m²], and (2, L) s and c [N·m], of unknowns x (L, K)."""
        return self.start[0] * np.exp(x[:, -3]), self.unit * x[:, -2:].T

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, windows·channels·steps) of `errors`."""
        chunks = [x[first : first + _LANES] for first in range(0, len(x), _LANES)]
        return np.concatenate(list(threads().map(self.errors, chunks))).reshape(len(x), -1)

    def errors(self, x: np.ndarray) -> np.ndarray:
        """(L, windows, channels, steps) scaled errors with unknowns x[l]."""
        inertia, gravity = self.load(x)
        lanes = np.arange(len(x))
        errors = []
        for segment in self.runs.segments:
            # every lane has the joint's rows, with its own load
            rows = np.repeat(segment.rows, len(x), axis=2)
            angle = rows[:, windows.POS]
            torque, stiffness = _gravity_torque(angle, gravity)
            rows[:, windows.INERTIA] = inertia
            rows[:, windows.STIFFNESS] = stiffness
            rows[:, windows.EXTERNAL] = torque - stiffness * angle

            loaded = SegmentArrays(rows, segment.windows)
            motors = grey_boxes(self.model)(x[:, :-_LOAD], lanes, loaded)
            errors.append(self.runs.run(motors, lanes, loaded))
        return np.concatenate(errors, axis=1)


def _gravity_torque(angle: np.ndarray, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Torque of a weight [N·m] and its derivative [N·m/rad], (T, M) each.

    Joint angles are (T, M), and ``gravity`` (2, M) is s and c [N·m].
    """
    s, c = gravity
    sine = np.sin(angle)
    cosine = np.cos(angle)
    return -(s * sine + c * cosine), -(s * cosine - c * sine)


def _regression(runs: WindowRuns) -> np.ndarray:
    """(3,) J₀, s₀, c₀ of the logged control law, by least squares on all rows.

    The law has no kd·velocity, which is like viscous friction.
    """
    channels = [windows.TARGET, windows.POS, windows.VEL, windows.KP]
    regressors = []
    torques = []
    for segment in runs.segments:
        target, angle, speed, kp = segment.rows[:, channels, 0].T
        acceleration = np.gradient(speed, runs.recipe.period)
        regressors.append(
            np.stack([acceleration, np.sin(angle), np.cos(angle), speed, np.sign(speed)])
        )
        torque = kp * (target - angle)
        if segment.has_frames:
            frames = [windows.VELOCITY_TARGET, windows.FEEDFORWARD]
            velocity_target, feedforward = segment.rows[:, frames, 0].T
            factors = [windows.KP_FACTOR, windows.KD_FACTOR]
            kp_factor, kd_factor = segment.rows[:, factors, 0].T
            torque = kp_factor * torque + feedforward
            if runs.logs_kd:
                torque += kd_factor * segment.rows[:, windows.KD, 0] * velocity_target
        torques.append(torque)

    matrix = np.concatenate(regressors, axis=1).T
    solution, *_ = np.linalg.lstsq(matrix, np.concatenate(torques), rcond=None)
    inertia, *gravity = solution[:_LOAD]
    min_inertia = 1e-5 * kp_of_size(runs)
    return np.array([np.clip(inertia, min_inertia, 1e4 * min_inertia), *gravity])


def _require_physical_gains(log: MotorLog) -> None:
    """Raise `LogError` unless the log has the scale of torques.

    It is that of logged torques, or of kp in N·m/rad, or of kd of velocity commands.
    """
    if log.command_mode == "torque":
        return
    name = "kd" if log.command_mode == "velocity" else "kp"
    gains = log.logged_kd if log.command_mode == "velocity" else log.logged_kp
    if gains is None or log.gain_unit != PHYSICAL_GAINS:
        problem = f"no {name}" if gains is None else f"{name} in firmware units"
        raise LogError(
            f"{problem}: without {name} in {PHYSICAL_GAINS} a load cannot be fitted",
            where=log.source,
            remedy=(
                f"in the column map, set gain = '{PHYSICAL_GAINS}' in [units], "
                f"and {name} of every joint in that unit"
            ),
        )


def with_fitted_loads(
    logs: MotorLog | Sequence[MotorLog],
    progress: Progress = PYTHON_WARNINGS,
    restarts: int = RESTARTS,
) -> list[MotorLog]:
    """Logs of the same motors and loads, with one rigid body per joint that is fitted to all logs.

    Inertia and weight, with their standard deviations, are reported to ``progress``.

    Args:
        logs: with gains in N·m/rad or under torque control, and the rows of the recording:
            `load_log` with `LogSettings.period` None. Their own loads and torques are replaced.
        progress: where to report to.
        restarts: maximum number of restarts of the search of a joint.

    Raises:
        ConfigError: no motor logs.
        LogError: gains in another unit, logs that are too short or do not fit together, a joint
            that does not move.
    """
    recordings = motor_logs(logs)
    for log in recordings:
        _require_physical_gains(log)
    smooth = [smooth_on_grid(log, RECIPE.period) for log in recordings]
    log = joined(smooth)

    title = f"fit the loads of {log.num_joints} joints"
    with progress.start(title, restarts * log.num_joints) as task:
        loads = fit_loads(log, task.advance, restarts)
    motions = np.std(log.joint_pos, axis=0).tolist()
    for name, load, motion in zip(log.joint_names, loads, motions, strict=True):
        progress.note(f"joint {name}: {load}, of {1e3 * motion:.0f} mrad of its motion")
    return [_with_loads(log, loads) for log in smooth]


def fit_loads(
    log: MotorLog, report: Callable[[], None] = lambda: None, restarts: int = RESTARTS
) -> tuple[FittedLoad, ...]:
    """Fit the load of every joint of a log with gains in N·m/rad or under torque control.

    The log's own loads and torques are ignored. ``report`` is called ``restarts`` times per joint,
    the maximum number.

    Raises:
        LogError: no such gains, another period than RECIPE's, a log that is too short, a static
            joint, or all simulations diverge.
    """
    _require_physical_gains(log)
    static = static_joints(log)
    if static:
        raise LogError(
            f"joint {static[0]} does not move", where=log.source, remedy="leave it out of the map"
        )
    loads = []
    for index in range(log.num_joints):
        loads.append(_fit_joint(log.joint(index), report, restarts))
    return tuple(loads)


def _fit_joint(log: MotorLog, report: Callable[[], None], restarts: int) -> FittedLoad:
    """Fit the load of the one joint of a log."""
    runs, terms = _runs_without_load(log)
    model = grey_box(initial_center(terms, runs), terms, runs.recipe)
    problem = _LoadProblem(model, runs)
    search = Search(problem)

    # prior of the motor's latents, then of the load's; fixed constants are not fitted
    num_constants = len(parameters_of(terms))
    fixed = np.append(fixed_constants(terms, runs), [False] * _LOAD)
    gravity_mean = problem.start[1:] / problem.unit
    mean = np.array([0.0] * num_constants + [np.log(0.5), *gravity_mean])
    load_std = [_STD_INERTIA, _STD_GRAVITY, _STD_GRAVITY]
    std = np.array([_STD_CONSTANT] * num_constants + load_std)

    fit = _searched(search, GaussianPrior(mean, std**-2.0), fixed, restarts, report)
    if not fit.loss[0] < _DIVERGED:
        raise LogError(
            f"the simulation of joint {log.joint_names[0]} diverges with every motor",
            where=log.source,
            remedy="check the log, its signs and its gains",
        )

    # Laplace: the whole log counts as one observation
    prior_std = np.where(fixed, 0.0, std)
    curvature = search.curvatures(fit.x, WIDE) / fit.loss[:, None, None]
    scaled = inverse_precision(curvature * prior_std * prior_std[:, None], np.ones((1, 1)))[0]
    covariance = scaled * prior_std * prior_std[:, None]
    deviation = np.sqrt(np.diagonal(covariance))

    inertia, gravity = problem.load(fit.x)
    position_errors = problem.errors(fit.x)[:, :, 0].astype(np.float64)
    return FittedLoad(
        inertia=float(inertia[0]),
        inertia_deviation=float(deviation[-_LOAD]),
        armature_deviation=float(deviation[PARAMETERS.index("armature")]),
        gravity=gravity[:, 0],
        gravity_covariance=problem.unit**2 * covariance[-2:, -2:],
        error=POSITION_SCALE * float(rms(position_errors)),
    )


def _runs_without_load(log: MotorLog) -> tuple[WindowRuns, tuple[str, ...]]:
    """Free runs over the log of one joint, without loads and torques, and terms of its motor."""
    zero = np.zeros_like(log.joint_pos)
    # a torque computed from a current is not the torque on the joint
    bare = replace(
        log, load_inertia=zero + 1.0, external_torque=zero, load_stiffness=None, joint_torque=None
    )
    recipe = with_logged_settings(windows.with_window_that_fits(RECIPE, log), log)
    data = windows.subsampled(windows.training_data(bare, recipe, log.source), recipe, _ROWS)
    runs = WindowRuns(data, recipe)

    # optional terms: logged ones, and effects of operating conditions that vary
    unidentified = terms_without_variation(runs)
    varying = [name for name in MIN_VARIATION if name not in unidentified]
    return runs, in_order([*recipe.logged_terms, *varying])


def _searched(
    search: Search,
    prior: GaussianPrior,
    fixed: np.ndarray,
    restarts: int,
    report: Callable[[], None],
) -> Fit:
    """The best fit.

    The prior counts as much as one window that is fitted as well as the average one.
    """
    rng = np.random.default_rng(_STREAM)
    shape = (1, _CANDIDATES, len(fixed))

    def weighted(loss: np.ndarray) -> GaussianPrior:
        precision = loss[0] / search.problem.observations * prior.precision
        return GaussianPrior(prior.mean, precision).fixing(fixed)

    def draw(restart: int, best: Fit) -> np.ndarray:
        sampled = (rng.random(shape) < 0.5) & ~fixed
        noise = _RADII[restart % len(_RADII)] * rng.standard_normal(shape)
        return best.x[:, None] + np.where(sampled, noise, 0.0)

    # with the loss that a fit probably reaches
    mean = np.where(fixed, 0.0, prior.mean)[None]
    expected = weighted(_EXPECTED * search.losses(mean))
    fit = search.at(mean, expected)
    for restart in range(_STARTS):
        start = search.best_of(draw(restart, fit), expected)
        fit = fit.better(search.descend(start, expected, _STEPS[:1]))

    # with the loss that was reached
    final = weighted(fit.loss)
    fit = search.at(fit.x, final)
    return search.until_found_again(fit, final, draw, restarts, _STEPS, report)


def _with_loads(log: MotorLog, loads: Sequence[FittedLoad]) -> MotorLog:
    """The log with these loads, and without a torque computed from currents."""
    gravity = np.stack([load.gravity for load in loads], axis=1)
    torque, stiffness = _gravity_torque(log.joint_pos, gravity)
    for segment in log.segment_slices():
        # logged ones are means until the next row
        torque[segment][:-1] = 0.5 * (torque[segment][:-1] + torque[segment][1:])

    loaded = replace(
        log,
        load_inertia=np.tile([load.inertia for load in loads], (log.num_rows, 1)),
        external_torque=torque,
        load_stiffness=stiffness,
        bodies="",
        posture=np.full(log.num_rows, POSTURES.index("fixed")),
        joint_torque=None,
        source=f"{log.source} (loads fitted)",
    )
    return checked(loaded, where=log.source)
