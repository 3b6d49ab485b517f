"""Fit of motors with the motor model as a level above them.

Motors of one model have similar constants. In the coordinates x of the searches, with the shift g_m
of the gear of motor m (`GEAR_POWERS`), the model mean μ, and the spread s (`MODEL_STD`),

    x_m ~ N(μ + g_m, s²),   μ ~ N(d, w²) for the constants that the maker states

minimises  Σ_m loss_m/ε_m + ½·Σ_m (x_m - g_m - μ)²/s² + ½·(μ - d)²/w². The scale

    ε_m = loss_m·(1/N + 2·MODEL_ERROR/SCORE²)

makes a likelihood of the loss of N windows: a window that is fitted as well as the average window
counts as one observation, and the error of the model is the same in all windows.

1. Search for one motor for all motors of a model (`_ModelProblem`).
2. Descend from there for every motor, and from its own fit; try samples and other motors'
   constants.
3. Newton step in μ, with x_m following it. With H_m = Hessian of loss_m/ε_m, S = diag(1/s²) and
   W = diag(1/w²),

       Δμ = (Σ_m (S - S·(H_m + S)⁻¹·S) + W)⁻¹·(Σ_m S·(x_m - g_m - μ) - W·(μ - d))

   A motor whose log identifies only ratios of constants, since its load is small, thereby informs
   about these ratios, and gets the scale from the others. TURNS repetitions of 2 and 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.estimates import SCORE
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.identification.physics.descents import (
    CANDIDATES,
    RIGID_STEPS,
    STEPS,
    reachable,
)
from motorprior.identification.physics.estimate_profiles import MODEL_ERROR
from motorprior.identification.physics.motor_problem import fixed_constants
from motorprior.identification.physics.population_fit import fit_from_samples
from motorprior.identification.physics.window_runs import SPEED_LIMITS, WindowRuns
from motorprior.identification.search import NARROW, WIDE, Fit, GaussianPrior, Problem, Search
from motorprior.robots.motor_models import GEAR_POWERS, MotorModel, StatedValue

# Standard deviation s between motors of one model: of the logarithm of a constant, of encoder_zero
# in units of 0.05 rad. Friction depends on bearings and assembly.
MODEL_STD = {
    **dict.fromkeys(("kp", "kd_over_kp", "torque_limit", "armature", "delay"), 0.1),
    **dict.fromkeys(("stall_torque", "no_load_speed", "integral_rate", "integral_limit"), 0.1),
    **dict.fromkeys(("profile_speed", "profile_acceleration", "dead_zone"), 0.05),
    **dict.fromkeys(("coulomb", "stribeck_torque", "viscous_damping", "load_friction"), 0.5),
    "encoder_zero": 1.0,
}
OTHER_STD = 0.25  # s of other constants
TURNS = 4  # repetitions
# A constant of a motor is an outlier if it differs from the median of its siblings by more than
# this number of standard deviations of such a difference.
MAX_DEVIATION = 2.5
_SEARCHING_TURNS = 2  # turns with new candidates
_LAST_STEPS = ((6, NARROW),)  # of the other turns
_STARTS = 3  # descents of the common motor, and as many from simplest motors
_MAX_CHANGE = 0.7  # maximum change of μ in a turn
_WEAK_STD = 5.0  # w of constants that the maker does not state


@dataclass(frozen=True)
class ModelLevel:
    """Motor models of M motors, in the coordinates x (K,) relative to a central motor."""

    names: tuple[str, ...]  # G models
    index: np.ndarray  # (M,) model of each motor
    shift: np.ndarray  # (M, K) g
    std: np.ndarray  # (K,) s
    stated: np.ndarray  # (G, K) d; 0 where nothing is stated
    stated_std: np.ndarray  # (G, K) w; _WEAK_STD where nothing is stated
    is_stated: np.ndarray  # (G, K)

    def mean_of(self, x: np.ndarray) -> np.ndarray:
        """(G, K) stated values, or medians over the motors of a model of x (M, K)."""
        own = x - self.shift
        medians = [np.median(own[self.index == model], axis=0) for model in range(len(self.names))]
        return np.where(self.is_stated, self.stated, medians)

    def prior_of(self, x: np.ndarray, scale: np.ndarray, fixed: np.ndarray) -> GaussianPrior:
        """Prior of the motors, whose model means are `mean_of` their fits x (M, K)."""
        return self.prior(self.mean_of(x), scale, fixed)

    def prior(self, mean: np.ndarray, scale: np.ndarray, fixed: np.ndarray) -> GaussianPrior:
        """Prior of the motors with model means μ (G, K) and scales ε (M,)."""
        precision = scale[:, None] / self.std**2
        return GaussianPrior(mean[self.index] + self.shift, precision).fixing(fixed)


def level_of_logs(
    runs: WindowRuns, center: np.ndarray, terms: tuple[str, ...]
) -> ModelLevel | None:
    """Motor models of the logs; None if they state none, or if each motor is fitted alone.

    Arguments as for `model_level`.
    """
    if runs.recipe.grey_boxes != "together":
        return None
    fixed = fixed_constants(terms, runs)
    return model_level(runs.motor_models, center, terms, runs.recipe.gain_unit, fixed)


def model_level(
    models: Sequence[MotorModel],
    center: np.ndarray,
    terms: tuple[str, ...],
    gain_unit: str,
    fixed: np.ndarray,
) -> ModelLevel | None:
    """The level of these ``models`` of M motors; None if no motor has a model.

    Args:
        models: of each motor, or none.
        center: (K,) decoder outputs of the central motor.
        terms: optional terms of the motors.
        gain_unit: of the recipe; kp relative to logged gains does not depend on the gear.
        fixed: (K,) mask of the constants that are not fitted.
    """
    if not models:
        return None
    constants = parameters_of(terms)
    names = tuple(dict.fromkeys(model.name for model in models))
    powers = np.array([GEAR_POWERS.get(name, 0.0) for name in constants])
    if gain_unit:
        powers[constants.index("kp")] = 0.0
    log_gears = np.log([model.gear for model in models])

    stated = np.zeros((len(names), len(constants)))
    stated_std = np.full(stated.shape, _WEAK_STD)
    for row, name in enumerate(names):
        model = next(model for model in models if model.name == name)
        for column, constant in enumerate(constants):
            value = _stated_value(model, constant)
            if value is not None:
                stated[row, column] = np.log(value.value) - center[column]
                stated_std[row, column] = value.std
    return ModelLevel(
        names=names,
        index=np.array([names.index(model.name) for model in models]),
        shift=np.where(fixed, 0.0, np.outer(log_gears, powers)),
        std=np.array([MODEL_STD.get(name, OTHER_STD) for name in constants]),
        stated=stated,
        stated_std=stated_std,
        is_stated=stated_std < _WEAK_STD,
    )


def _stated_value(model: MotorModel, constant: str) -> StatedValue | None:
    """The stated value of a constant at the output shaft of the motor, if any."""
    return getattr(model, "max_speed" if constant in SPEED_LIMITS else constant, None)


def likelihood_scale(search: Search, loss: np.ndarray) -> np.ndarray:
    """(M,) scales ε of motors with these losses (M,)."""
    return loss * (1.0 / search.problem.observations + 2.0 * MODEL_ERROR / SCORE**2)


class _ModelProblem:
    """One problem: all motors of a model with the same constants, apart from their gears.

    ``members`` (n,) are their indices among the problems of ``motors``.
    """

    def __init__(self, motors: Problem, members: np.ndarray, shift: np.ndarray):
        self._motors = motors
        self._members = members
        self._shift = shift[members]
        self.count = 1
        self.weight = motors.weight
        self.observations = motors.observations * len(members)

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """See `search.Problem`."""
        lanes = (x[:, None] + self._shift).reshape(-1, x.shape[1])
        members = np.tile(self._members, len(x))
        return self._motors.residuals(lanes, members).reshape(len(x), -1)


def fitted_with_models(
    search: Search,
    rng: np.random.Generator,
    separate: np.ndarray,
    simplest: np.ndarray,
    fixed: np.ndarray,
    level: ModelLevel,
) -> Fit:
    """Fit of motors with their models.

    Args:
        search: of the motors' problems.
        rng: for the candidates.
        separate: (M, K) motors that were fitted alone.
        simplest: (M, K) simplest motors, from which a common motor is searched, too.
        fixed: (K,) mask of the constants that are not fitted.
        level: the motor models.
    """
    losses = search.losses(separate)
    scale = likelihood_scale(search, losses)
    mean = _common_motors(search, rng, separate, simplest, losses, fixed, level)
    start = mean[level.index] + level.shift
    for turn in range(_SEARCHING_TURNS):
        prior = level.prior(mean, scale, fixed)
        steps = STEPS if turn == 0 else _LAST_STEPS
        fit = search.descend(np.where(fixed, 0.0, start), prior, steps)

        from_separate = np.where(level.is_stated[level.index], prior.mean, separate)
        fit = fit.better(search.descend(from_separate, prior, STEPS[1:]))
        fit = fit_from_samples(search, rng, fit, prior, level.std, fixed, RIGID_STEPS)
        mean, start = _newton_step(search, fit, fixed, level, mean, scale)
    return _descended(search, start, mean, scale, fixed, level, TURNS - _SEARCHING_TURNS)


def refined_with_models(search: Search, x: np.ndarray, fixed: np.ndarray, level: ModelLevel) -> Fit:
    """Fit of motors with their models after descents from x (M, K), without candidates."""
    scale = likelihood_scale(search, search.losses(x))
    return _descended(search, x, level.mean_of(x), scale, fixed, level, TURNS)


def _descended(
    search: Search,
    start: np.ndarray,
    mean: np.ndarray,
    scale: np.ndarray,
    fixed: np.ndarray,
    level: ModelLevel,
    turns: int,
) -> Fit:
    """Fit after ``turns`` descents and Newton steps from ``start`` (M, K) and ``mean`` (G, K)."""
    for _ in range(turns):
        prior = level.prior(mean, scale, fixed)
        fit = search.descend(np.where(fixed, 0.0, start), prior, _LAST_STEPS)
        mean, start = _newton_step(search, fit, fixed, level, mean, scale)
    return search.descend(start, level.prior(mean, scale, fixed), ((6, WIDE), (6, NARROW)))


def _common_motors(
    search: Search,
    rng: np.random.Generator,
    separate: np.ndarray,
    simplest: np.ndarray,
    losses: np.ndarray,
    fixed: np.ndarray,
    level: ModelLevel,
) -> np.ndarray:
    """(G, K) the best common motor of each model.

    It is searched from its ``separate`` motors (M, K), which have these ``losses`` (M,), and from
    the ``simplest`` motors (M, K): motors that were fitted alone agree on a wrong optimum if each
    has too small a load.
    """
    mean = level.mean_of(separate)
    common = mean.copy()
    size = len(fixed)
    for model in range(len(level.names)):
        members = np.flatnonzero(level.index == model)
        if len(members) == 1:
            continue
        pooled = Search(_ModelProblem(search.problem, members, level.shift))
        own = separate[members] - level.shift[members]
        simple = simplest[members] - level.shift[members]
        middle = np.median(simple, axis=0)
        samples = np.concatenate([mean[[model]], own, middle[None], simple])
        picks = rng.integers(len(samples), size=(CANDIDATES, size))
        candidates = np.take_along_axis(samples, picks, axis=0)
        candidates += 0.5 * rng.standard_normal((CANDIDATES, size))
        candidates[: len(samples)] = samples
        noise = rng.standard_normal((CANDIDATES, size))
        near_stated = level.stated[model] + 0.5 * level.stated_std[model] * noise
        candidates = np.where(level.is_stated[model], near_stated, candidates)
        candidates = reachable(candidates, fixed)[None]

        # constants that are not stated have a weak prior around the middle of the motors
        pooled_scale = likelihood_scale(pooled, losses[members].mean())
        center = np.where(level.is_stated[model], level.stated[model], mean[model])
        prior = GaussianPrior(center, pooled_scale / level.stated_std[model] ** 2).fixing(fixed)
        energies = pooled.losses(candidates)[0] + prior.energy(candidates)[0]
        order = np.argsort(energies)
        is_simple = (order > len(own)) & (order < len(samples))
        starts = np.concatenate([order[:_STARTS], order[is_simple][:_STARTS]])
        best = None
        for start in starts:
            descended = pooled.descend(candidates[:, start], prior, STEPS[:3])
            best = descended if best is None else best.better(descended)
        assert best is not None
        common[model] = best.x[0]
    return common


def _newton_step(
    search: Search,
    fit: Fit,
    fixed: np.ndarray,
    level: ModelLevel,
    mean: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The model means μ (G, K) after a Newton step, and unknowns (M, K) that follow it."""
    curvatures = search.curvatures(fit.x, WIDE) / scale[:, None, None]
    spread_precision = np.diag(1.0 / level.std**2)
    new_mean = mean.copy()
    x = fit.x.copy()
    for model in range(len(level.names)):
        stated_precision = np.where(fixed, 1e6, 1.0 / level.stated_std[model] ** 2)
        information = np.diag(stated_precision)
        target = np.where(level.is_stated[model], level.stated[model], mean[model])
        gradient = stated_precision * (target - mean[model])
        following = {}
        for motor in np.flatnonzero(level.index == model):
            share = np.linalg.solve(curvatures[motor] + spread_precision, spread_precision)
            following[motor] = share
            information += spread_precision - spread_precision @ share
            deviation = fit.x[motor] - level.shift[motor] - mean[model]
            gradient += np.where(fixed, 0.0, deviation) / level.std**2
        change = np.linalg.solve(information, gradient)
        change = np.where(fixed, 0.0, np.clip(change, -_MAX_CHANGE, _MAX_CHANGE))
        new_mean[model] += change
        for motor, share in following.items():
            x[motor] += np.where(fixed, 0.0, share @ change)
    return new_mean, reachable(x, fixed)


def sibling_deviations(level: ModelLevel, x: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """(M, K) deviations of constants that the motor's siblings contradict; 0 for the others.

    The siblings contradict a constant if it differs from the median of the n - 1 other motors of
    its model by more than MAX_DEVIATION·s·√(1 + 1/(n - 1)). The median is not moved by one outlier.
    A motor without siblings has no such constants.
    """
    own = x - level.shift
    contradicted = np.zeros(x.shape)
    for motor, model in enumerate(level.index):
        siblings = np.flatnonzero((level.index == model) & (np.arange(len(x)) != motor))
        if len(siblings):
            std = level.std * np.sqrt(1.0 + 1.0 / len(siblings))
            deviation = own[motor] - np.median(own[siblings], axis=0)
            is_outlier = (np.abs(deviation) > MAX_DEVIATION * std) & ~fixed
            contradicted[motor] = np.where(is_outlier, deviation, 0.0)
    return contradicted
