"""An unknown load, fitted together with its motor: a rigid body on the joint of a robot with a fixed base.

    load_inertia = J,   external_torque = -(s·sin q + c·cos q),   load_stiffness = -(s·cos q - c·sin q)

q is the joint angle. Free runs of the grey box have three more latents: ln(J/J₀), s/g and c/g, with
g = 0.2 rad·kp. Their prior is about a regression of the logged proportional control law,

    kp·(position_target - q) = J₀·q̈ + s₀·sin q + c₀·cos q + d·q̇ + f·sign q̇.

Gains must be logged in N·m/rad, since angles and commands do not identify the scale of torques.
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
)
from motorprior.identification.physics.term_selection import MIN_VARIATION, same_conditions
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
from motorprior.progress import WARNED, Progress
from motorprior.signals import rms

RECIPE = PRESETS["pace_long_runs"]  # runs of a second, logged optional terms only
MAX_ROUNDS = 24  # restarts per joint, at most
_SAG = 0.2  # g over kp [rad]
_LOAD = 3  # latents of the load; they come last
_ROWS = 30_000  # approximate maximum number of fitted rows
_RADII = (1.0, 0.5, 0.35)
_CANDIDATES = 96
_STARTS = 3
_STEPS = ((10, WIDE), (6, NARROW))
# prior of a latent, of ln(J/J₀), of s/g and c/g
_STD_CONSTANT = 1.0
_STD_INERTIA = 2.0
_STD_GRAVITY = 1.0
# loss after a fit over that before; loss of a simulation that diverges
_EXPECTED = 0.01
_DIVERGED = 1e6
_LANES = 32  # loads simulated at a time; each has its own rows
_STREAM = 61


@dataclass(frozen=True)
class FittedLoad:
    """Load of a joint."""

    inertia: float  # J [kg·m²]
    inertia_deviation: float  # standard deviation of ln J [-]
    armature_deviation: float  # that of the logarithm of the motor's armature [-]
    gravity: np.ndarray  # (2,) s and c [N·m]
    gravity_covariance: np.ndarray  # (2, 2) theirs [N²·m²]
    error: float  # root mean square of the residual position error [rad]

    def __str__(self) -> str:
        # W·sin(q - h) = s·sin q + c·cos q with W = √(s² + c²), whose deviation is that along (s, c)
        weight = float(np.hypot(*self.gravity))
        along = self.gravity / max(weight, 1e-12)
        std = float(np.sqrt(along @ self.gravity_covariance @ along))
        gravity = (
            f"{weight:.2g} ± {std:.1g} N·m"
            if weight > 2.0 * std
            else f"below {weight + 2.0 * std:.1g} N·m"
        )
        factors = f"1 σ ×/÷ {np.exp(self.inertia_deviation):.2f}, of the armature {np.exp(self.armature_deviation):.2f}"
        return f"inertia {self.inertia:.2g} kg·m² ({factors}); weight {gravity}; residual {1e3 * self.error:.1f} mrad"


class _LoadProblem(MotorProblem):
    """Free runs of one joint; the last unknowns are those of its load."""

    def __init__(self, model: GreyBox, runs: WindowRuns):
        super().__init__(model, runs)
        # (3,) J₀ [kg·m²], s₀ and c₀ [N·m]; g [N·m]
        self.start = _regression(runs)
        self.unit = _SAG * float(runs.gains[0, 0])

    def load(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(L,) inertia [kg·m²] and (2, L) s and c [N·m] of unknowns x (L, K)."""
        return self.start[0] * np.exp(x[:, -3]), self.unit * x[:, -2:].T

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, windows·channels·steps) of `errors`."""
        chunks = [x[first : first + _LANES] for first in range(0, len(x), _LANES)]
        return np.concatenate(list(threads().map(self.errors, chunks))).reshape(len(x), -1)

    def errors(self, x: np.ndarray) -> np.ndarray:
        """(L, windows, channels, steps) scaled errors with unknowns x[l]."""
        (inertia, gravity), lanes, found = self.load(x), np.arange(len(x)), []
        for segment in self.runs.segments:
            rows = np.repeat(segment.rows, len(x), axis=2)
            torque, stiffness = _gravity_torque(rows[:, windows.POS], gravity)
            rows[:, windows.INERTIA] = inertia
            rows[:, windows.STIFFNESS] = stiffness
            rows[:, windows.EXTERNAL] = torque - stiffness * rows[:, windows.POS]
            loaded = SegmentArrays(rows, segment.windows)
            found.append(
                self.runs.run(grey_boxes(self.model)(x[:, :-_LOAD], lanes, loaded), lanes, loaded)
            )
        return np.concatenate(found, axis=1)


def _gravity_torque(angle: np.ndarray, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Torque of a weight [N·m] and its derivative [N·m/rad] at joint angles (T, M), for s and c (2, M)."""
    s, c = gravity
    sine = np.sin(angle)
    cosine = np.cos(angle)
    return -(s * sine + c * cosine), -(s * cosine - c * sine)


def _regression(runs: WindowRuns) -> np.ndarray:
    """(3,) J₀, s₀, c₀ of the logged proportional control law on all rows."""
    regressors = []
    torques = []
    for segment in runs.segments:
        target, angle, speed, kp = segment.rows[
            :, [windows.TARGET, windows.POS, windows.VEL, windows.KP], 0
        ].T
        acceleration = np.gradient(speed, runs.recipe.period)
        regressors.append(
            np.stack([acceleration, np.sin(angle), np.cos(angle), speed, np.sign(speed)])
        )
        torques.append(kp * (target - angle))
    found = np.linalg.lstsq(
        np.concatenate(regressors, axis=1).T, np.concatenate(torques), rcond=None
    )[0][:_LOAD]
    lower = 1e-5 * float(runs.gains[0, 0])
    return np.array([np.clip(found[0], lower, 1e4 * lower), *found[1:]])


def _require_physical_kp(log: MotorLog) -> None:
    """Raise `LogError` unless the log has kp in N·m/rad, which sets the scale of torques."""
    if log.logged_kp is None or log.gain_unit != PHYSICAL_GAINS:
        has = "no kp" if log.logged_kp is None else "kp in firmware units"
        raise LogError(
            f"{has}: without kp in {PHYSICAL_GAINS} a load cannot be fitted",
            where=log.source,
            remedy=f"in the column map, set gain = '{PHYSICAL_GAINS}' in [units], and kp of every joint in that unit",
        )


def with_fitted_loads(
    logs: MotorLog | Sequence[MotorLog], progress: Progress = WARNED
) -> list[MotorLog]:
    """Logs of the same motors and loads, with one rigid body per joint that is fitted to all of them.

    Inertia and weight, with their standard deviations, are reported to ``progress``.

    Args:
        logs: with gains in N·m/rad, and the rows of the recording: `load_log` with `LogSettings.period` None.
            Their own loads and torques are replaced.
        progress: where to report to.

    Raises:
        ConfigError: no motor logs.
        LogError: gains in another unit, logs that are too short or do not fit together, a joint
            that does not move.
    """
    every = motor_logs(logs)
    for log in every:
        _require_physical_kp(log)
    smooth = [smooth_on_grid(log, RECIPE.period) for log in every]
    log = joined(smooth)
    with progress.start(
        f"fit the loads of {log.num_joints} joints", MAX_ROUNDS * log.num_joints
    ) as task:
        loads = fit_loads(log, task.advance)
    for name, load, motion in zip(
        log.joint_names, loads, np.std(log.joint_pos, axis=0).tolist(), strict=True
    ):
        progress.note(f"joint {name}: {load}, of {1e3 * motion:.0f} mrad of its motion")
    return [_with_loads(each, loads) for each in smooth]


def fit_loads(log: MotorLog, report: Callable[[], None] = lambda: None) -> tuple[FittedLoad, ...]:
    """Fit the load of every joint of a log with gains in N·m/rad; its own loads and torques are ignored.

    ``report`` is called MAX_ROUNDS times per joint at most. Raises LogError for no such gains,
    another period than RECIPE's, a log that is too short, a static joint, or if all simulations
    diverge.
    """
    _require_physical_kp(log)
    if static := static_joints(log):
        raise LogError(
            f"joint {static[0]} does not move", where=log.source, remedy="leave it out of the map"
        )
    return tuple(_fit_joint(log.joint(index), report) for index in range(log.num_joints))


def _fit_joint(log: MotorLog, report: Callable[[], None]) -> FittedLoad:
    zero = np.zeros_like(log.joint_pos)
    # a torque computed from a current is not the torque on the joint
    bare = replace(
        log, load_inertia=zero + 1.0, external_torque=zero, load_stiffness=None, joint_torque=None
    )
    recipe = with_logged_settings(windows.with_window_that_fits(RECIPE, log), log)
    data = windows.subsampled(windows.training_data(bare, recipe, log.source), recipe, _ROWS)
    runs = WindowRuns(data, recipe)
    same = same_conditions(runs)
    terms = in_order([*recipe.logged_terms, *(name for name in MIN_VARIATION if name not in same)])
    constants = len(parameters_of(terms))
    fixed = np.append(fixed_constants(terms, runs), [False] * _LOAD)
    problem = _LoadProblem(grey_box(initial_center(terms, runs), terms, recipe), runs)
    mean = np.array([0.0] * constants + [np.log(0.5), *problem.start[1:] / problem.unit])
    std = np.array([_STD_CONSTANT] * constants + [_STD_INERTIA, _STD_GRAVITY, _STD_GRAVITY])
    search = Search(problem)
    prior = GaussianPrior(mean, std**-2.0)
    found = _searched(search, prior, fixed, report)
    if not found.loss[0] < _DIVERGED:
        raise LogError(
            f"the simulation of joint {log.joint_names[0]} diverges with every motor",
            where=log.source,
            remedy="check the log, its signs and its gains",
        )
    prior_std = np.where(fixed, 0.0, std)
    curvature = search.curvatures(found.x, WIDE) / found.loss[:, None, None]
    scaled = inverse_precision(curvature * prior_std * prior_std[:, None], np.ones((1, 1)))[0]
    covariance = scaled * prior_std * prior_std[:, None]
    deviation = np.sqrt(np.diagonal(covariance))
    (inertia, gravity), errors = (
        problem.load(found.x),
        problem.errors(found.x)[:, :, 0].astype(np.float64),
    )
    return FittedLoad(
        float(inertia[0]),
        float(deviation[-_LOAD]),
        float(deviation[PARAMETERS.index("armature")]),
        gravity[:, 0],
        problem.unit**2 * covariance[-2:, -2:],
        POSITION_SCALE * float(rms(errors)),
    )


def _searched(
    search: Search, prior: GaussianPrior, fixed: np.ndarray, report: Callable[[], None]
) -> Fit:
    """The best fit; the prior counts as much as one window that is fitted as well as the average one."""
    rng = np.random.default_rng(_STREAM)
    shape = (1, _CANDIDATES, len(fixed))

    def weighted(loss: np.ndarray) -> GaussianPrior:
        return GaussianPrior(
            prior.mean, loss[0] / search.problem.observations * prior.precision
        ).fixing(fixed)

    def draw(restart: int, best: Fit) -> np.ndarray:
        sampled = (rng.random(shape) < 0.5) & ~fixed
        return best.x[:, None] + np.where(
            sampled, _RADII[restart % len(_RADII)] * rng.standard_normal(shape), 0.0
        )

    first = weighted(_EXPECTED * search.losses(np.where(fixed, 0.0, prior.mean)[None]))
    found = search.at(np.where(fixed, 0.0, prior.mean)[None], first)
    for restart in range(_STARTS):
        found = found.better(
            search.descend(search.best_of(draw(restart, found), first), first, _STEPS[:1])
        )
    final = weighted(found.loss)
    return search.until_found_again(
        search.at(found.x, final), final, draw, MAX_ROUNDS, _STEPS, report
    )


def _with_loads(log: MotorLog, loads: Sequence[FittedLoad]) -> MotorLog:
    """The log with these loads, and without a torque computed from currents."""
    torque, stiffness = _gravity_torque(
        log.joint_pos, np.stack([load.gravity for load in loads], axis=1)
    )
    for part in log.segment_slices():
        # logged ones are means until the next row
        torque[part][:-1] = 0.5 * (torque[part][:-1] + torque[part][1:])
    channels = {
        "load_inertia": np.tile([load.inertia for load in loads], (log.num_rows, 1)),
        "external_torque": torque,
        "load_stiffness": stiffness,
        "posture": np.full(log.num_rows, POSTURES.index("fixed")),
    }
    source = f"{log.source} (loads fitted)"
    return checked(replace(log, **channels, joint_torque=None, source=source), where=log.source)
