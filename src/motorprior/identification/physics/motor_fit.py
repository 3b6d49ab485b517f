"""Fit of motors to their logs: every motor alone, or together with a Gaussian over the motors.

The unknowns are decoder outputs, one per constant, relative to a central motor: logarithms of
positive constants, and multiples of the unit of signed constants.

Each motor alone:

1. Fit the simplest motor: a rigid gear with Coulomb and viscous friction, and a torque limit if it
   improves the fit. A descent that starts without a limit does not find one.
2. Restart from three kinds of candidates: from this optimum, with the constants that the simplest
   motor lacks sampled around the initial motor; from the best motor so far, with a random half of
   its constants resampled; and from other motors' constants. A motor never fits worse than its
   simplest motor.
3. Stop when the best optimum of each motor was found three times.

Motors together: `motor_model_fit` continues from these fits if the robot's description states the
motor models, otherwise `population_fit`. All searches use short free runs; `refinement` takes the
last steps.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, PARAMETERS, parameters_of
from motorprior.actuator.optional_terms import constants_of
from motorprior.identification.checkpoint import PartCheckpoint, unsaved_part
from motorprior.identification.physics.descents import (
    CANDIDATES,
    FINEST,
    RIGID_STEPS,
    STEPS,
    add_other_motors,
    reachable,
)
from motorprior.identification.physics.effect_scales import effect_scale
from motorprior.identification.physics.limits import LimitedMotors, with_decided_limits
from motorprior.identification.physics.motor_model_fit import (
    fitted_with_models,
    level_of_logs,
    refined_with_models,
)
from motorprior.identification.physics.motor_problem import (
    WEAK_PRECISION,
    centred_search,
    fixed_constants,
    log_unlimited_torque,
    rigid_motor,
    scaled_center,
    single_motor_prior,
    with_more_terms,
)
from motorprior.identification.physics.population_fit import (
    MIN_OTHERS,
    TURNS,
    empirical_bayes,
    searched_near_others,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.search import FIXED, NARROW, Fit, GaussianPrior, Search

RIGID_STARTS = 2  # random searches for the simplest motors
RIGID_CANDIDATES = 256  # candidates of each of these searches
RIGID_STD = 1.5  # standard deviation of these candidates
NEAR_STD = 0.3  # standard deviation of candidates near a motor
# lower and upper bounds of drawn constants, in units of `effect_scale`
PROPORTIONS = {
    "armature": (0.3, 30.0),
    "coulomb": (0.3, 30.0),
    "viscous_damping": (0.3, 30.0),
    "torque_limit": (0.03, 1.2),
}
RESTARTS = 48  # maximum number of restarts of a motor
LEADERS = 6  # motors of a fleet that are searched fully; the other motors also start from them
STAGES = 1 + RESTARTS + TURNS  # number of reports of a fit
_STREAM = 41
_GEAR_STIFFNESS = PARAMETERS.index("gear_stiffness")


@dataclass(frozen=True)
class MotorFits:
    """Fitted motors."""

    center: np.ndarray  # (K,) decoder outputs of a central motor
    offsets: np.ndarray  # (M, K) decoder outputs of the motors, relative to the central motor
    loss: np.ndarray  # (M,)
    terms: tuple[str, ...]  # optional terms
    is_rigid: bool = False  # whether these are simplest motors, of `fit_rigid_motors`

    @property
    def outputs(self) -> np.ndarray:
        """(M, K) decoder outputs of the motors."""
        return self.center + self.offsets


def fit_motors(
    runs: WindowRuns,
    terms: tuple[str, ...],
    together: bool,
    seed: int,
    report: Callable[[], None] = lambda: None,
    subset: WindowRuns | None = None,
    nested: MotorFits | None = None,
    restarts: int = RESTARTS,
    checkpoint: PartCheckpoint = unsaved_part,
) -> MotorFits:
    """Fit all motors of the logs.

    Args:
        runs: free runs over the logs.
        terms: optional terms of the motors.
        together: whether the motors are fitted with a Gaussian over the motors, or each alone.
        seed: of the candidates.
        report: called STAGES times.
        subset: free runs over some of the rows, used by all descents but the last; ``runs`` if not
            given.
        nested: fit of simpler motors to start from; `fit_rigid_motors` if not given.
        restarts: maximum number of restarts of a motor.
        checkpoint: saves every descent.
    """
    subset = subset or runs
    rng = np.random.default_rng([seed, _STREAM])
    nested = nested or fit_rigid_motors(subset, terms, seed, checkpoint=checkpoint)
    initial = scaled_center(subset, terms)
    center, candidates = _starting_point(rng, runs, terms, nested, initial)
    fixed = candidates.fixed
    report()

    search = centred_search(center, terms, subset, checkpoint)
    all_rows_search = search
    if subset is not runs:
        all_rows_search = centred_search(center, terms, runs, checkpoint)

    level = level_of_logs(runs, center, terms) if together else None
    if level is None:
        fit = _fit_separately(search, candidates, restarts, report)
        search = all_rows_search
        if subset is not runs:
            prior = single_motor_prior(search, fit.x, fit.x, candidates.initial)
            fit = search.descend(fit.x, prior.fixing(fixed), STEPS)
        if together and runs.num_motors > MIN_OTHERS:
            fit = searched_near_others(search, rng, fit, fixed, runs.classes, restarts // 4)
        if together and runs.num_motors > 1:
            fit = empirical_bayes(search, rng, fit, fixed, runs.classes, report)
    else:
        # few restarts: the motors of a model are searched together afterwards
        separate = _fit_separately(search, candidates, restarts // 4, report).x
        fit = fitted_with_models(search, rng, separate, candidates.nested, fixed, level)
        search = all_rows_search
        if subset is not runs:
            fit = refined_with_models(search, fit.x, fixed, level)
        for _ in range(restarts - restarts // 4 + TURNS):
            report()
    groups = search.all_problems
    if together:
        groups = runs.classes if level is None else level.index
    motors = LimitedMotors(search, center, terms, runs, fixed, groups, level)
    x = with_decided_limits(motors, fit.x)
    x = np.where(fixed, 0.0, x)

    # move the centre to a point from which the decoder reaches every motor
    min_shift = x.max(axis=0) - MAX_LOG_FACTOR
    max_shift = x.min(axis=0) + MAX_LOG_FACTOR
    shift = np.clip(np.median(x, axis=0), min_shift, max_shift)
    center = center + shift
    x = x - shift
    losses = centred_search(center, terms, runs).losses(x)
    return MotorFits(center, x, losses, terms)


def fit_rigid_motors(
    runs: WindowRuns,
    terms: tuple[str, ...],
    seed: int,
    limits: bool = True,
    checkpoint: PartCheckpoint = unsaved_part,
) -> MotorFits:
    """The simplest motors: the best of RIGID_STARTS random searches without a torque limit.

    If ``limits``, RIGID_STARTS searches with a torque limit follow. The other arguments are as for
    `fit_motors`.
    """
    rng = np.random.default_rng([seed, _STREAM, 1])
    fixed = fixed_constants(terms, runs)
    center, is_simplified = rigid_motor(scaled_center(runs, terms), terms, runs)
    offsets = np.zeros((runs.num_motors, len(center)))
    is_limit = np.array(parameters_of(terms)) == "torque_limit"

    frozen = fixed | is_simplified
    fits = _searched_rigid(rng, runs, terms, center, offsets, frozen, checkpoint)
    if limits and not fixed[is_limit].any():
        # The limit without effect is as far from a motor's own limit as its kp is from the initial
        # kp. The second search is therefore around the motors of the first one.
        outputs = fits.outputs
        middle = 0.5 * (outputs.min(axis=0) + outputs.max(axis=0))
        middle[is_limit] = log_unlimited_torque(middle, terms, runs)
        offsets = np.where(is_limit, 0.0, outputs - middle)
        frozen = fixed | (is_simplified & ~is_limit)
        fits = _searched_rigid(rng, runs, terms, middle, offsets, frozen, checkpoint)
    return fits


def _searched_rigid(
    rng: np.random.Generator,
    runs: WindowRuns,
    terms: tuple[str, ...],
    center: np.ndarray,
    offsets: np.ndarray,
    frozen: np.ndarray,
    checkpoint: PartCheckpoint,
) -> MotorFits:
    """The simplest motors after RIGID_STARTS searches around ``center`` (K,) + ``offsets`` (M, K).

    ``frozen`` (K,) constants stay there.
    """
    search = centred_search(center, terms, runs, checkpoint)
    prior = GaussianPrior(
        mean=np.where(frozen, offsets, 0.0),
        precision=np.where(frozen, FIXED, WEAK_PRECISION),
    )
    fit = search.at(offsets, prior)
    for _ in range(RIGID_STARTS):
        candidates = _rigid_candidates(rng, runs, terms, center, fit.x, frozen)
        start = search.best_of(candidates, prior)
        fit = fit.better(search.descend(start, prior, RIGID_STEPS[:1]))

    fit = search.descend(fit.x, prior, RIGID_STEPS[1:])
    x = np.clip(fit.x, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
    return MotorFits(center, x, fit.loss, terms, is_rigid=True)


def _rigid_candidates(
    rng: np.random.Generator,
    runs: WindowRuns,
    terms: tuple[str, ...],
    center: np.ndarray,
    x: np.ndarray,
    frozen: np.ndarray,
) -> np.ndarray:
    """(M, RIGID_CANDIDATES, K) candidates of the simplest motors, relative to ``center`` (K,).

    In the first half, all constants are sampled around the centre, in the second half around the
    motors x (M, K). In every second one of each half, friction, rotor and limit are drawn in
    proportion to the candidate's gains and load: a motor may be of any size.
    """
    names = parameters_of(terms)
    noise = rng.standard_normal((len(x), RIGID_CANDIDATES, len(center)))
    candidates = np.where(frozen, x[:, None], RIGID_STD * noise)
    half = RIGID_CANDIDATES // 2
    candidates[:, half:] = x[:, None] + np.where(frozen, 0.0, NEAR_STD * noise[:, half:])

    values = {}
    for name in ("kp", "kd_over_kp"):
        column = names.index(name)
        values[name] = np.exp(center[column] + candidates[..., column])
    for name, (low, high) in PROPORTIONS.items():
        column = names.index(name)
        drawn = rng.uniform(np.log(low), np.log(high), candidates.shape[:2])
        with np.errstate(divide="ignore"):
            proportional = np.log(effect_scale(name, values, runs)) + drawn - center[column]
        if not frozen[column]:
            candidates[:, 1::2, column] = proportional[:, 1::2]

    candidates[:, 0] = x
    return np.clip(candidates, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)


@dataclass(frozen=True)
class _Candidates:
    """Candidates (M, CANDIDATES, K) of the restarts, relative to the central motor."""

    rng: np.random.Generator
    nested: np.ndarray  # (M, K) fits of simpler motors, without the missing constants
    initial: np.ndarray  # (K,) initial motor, with the missing constants
    rigid: np.ndarray  # (K,) rigid version of the initial motor, without the missing constants
    missing: np.ndarray  # (K,) mask of the constants that the nested motors lack
    fixed: np.ndarray  # (K,) mask of the constants that are not fitted

    @property
    def shape(self) -> tuple[int, int, int]:
        """Motors, candidates, unknowns."""
        motors, unknowns = self.nested.shape
        return motors, CANDIDATES, unknowns

    def draw(self, restart: int, best: Fit) -> np.ndarray:
        """Candidates of a restart; four ways to draw them take turns."""
        ways = (self._nested_with_some, self._best_changed, self._nested_with_all, self._anywhere)
        noise = self.rng.standard_normal(self.shape)
        return reachable(ways[restart % len(ways)](noise, best), self.fixed)

    def _nested_with_some(self, noise: np.ndarray, best: Fit) -> np.ndarray:
        """The nested motor with a random half of the missing constants and a soft gear."""
        near_nested = self.nested[:, None] + 0.2 * noise * ~self.missing
        sampled = self.missing & (self.rng.random(self.shape) < 0.5)
        candidates = np.where(sampled, self.initial + 1.5 * noise, near_nested)

        # the soft gear is to the initial gear as the initial gear is to the rigid gear
        gear = _GEAR_STIFFNESS
        if self.missing[gear]:
            soft = 2.0 * self.initial[gear] - self.rigid[gear]
            candidates[..., gear] = soft + 0.5 * noise[..., gear]
        return candidates

    def _best_changed(self, noise: np.ndarray, best: Fit) -> np.ndarray:
        """The best motor with a random half of its constants changed, and the other motors."""
        changed = self.rng.random(self.shape) < 0.5
        candidates = np.where(changed, best.x[:, None] + 0.5 * noise, best.x[:, None])
        add_other_motors(self.rng, candidates, best.x)
        return candidates

    def _nested_with_all(self, noise: np.ndarray, best: Fit) -> np.ndarray:
        """The nested motor with the initial motor's values of the missing constants."""
        near_nested = self.nested[:, None] + 0.3 * noise
        return np.where(self.missing, self.initial + 0.5 * noise, near_nested)

    def _anywhere(self, noise: np.ndarray, best: Fit) -> np.ndarray:
        """Any motor, with a few constants of the best one."""
        sampled = self.rng.random(self.shape) < 0.8
        return np.where(sampled, self.initial + 0.7 * noise, best.x[:, None])

    def draw_near(self, leaders: np.ndarray, restart: int, best: Fit) -> np.ndarray:
        """Candidates near the ``leaders`` (n, K) in every second restart, otherwise as `draw`."""
        candidates = self.draw(restart, best)
        leader = leaders[self.rng.integers(len(leaders), size=self.shape[:2])]
        noise = 0.3 * self.rng.standard_normal(self.shape)
        near = leader + noise * (self.rng.random(self.shape) < 0.5)
        return np.where(self.fixed, 0.0, near) if restart % 2 == 0 else candidates


def _starting_point(
    rng: np.random.Generator,
    runs: WindowRuns,
    terms: tuple[str, ...],
    nested: MotorFits,
    initial: np.ndarray,
) -> tuple[np.ndarray, _Candidates]:
    """Central motor (K,) of a search, and the candidates of its restarts.

    ``initial`` (K,) are decoder outputs of the initial motor; other arguments as for `fit_motors`.
    """
    # The nested motors lack the constants of new terms and, if they are simplest motors, the other
    # constants that `rigid_motor` simplifies.
    fixed = fixed_constants(terms, runs)
    rigid, is_simplified = rigid_motor(initial, terms, runs)
    names = parameters_of(terms)
    is_new = np.isin(names, constants_of(set(terms) - set(nested.terms)))
    is_lacked_by_rigid = nested.is_rigid & np.isin(names, PARAMETERS)
    missing = is_simplified & (is_new | is_lacked_by_rigid)

    # The central motor is halfway between the rigid and the initial values of missing constants,
    # and in the middle of the nested motors for the other constants.
    start = with_more_terms(nested.outputs, nested.terms, terms, runs)  # (M, K)
    middle_of_nested = 0.5 * (start.min(axis=0) + start.max(axis=0))
    halfway = 0.5 * (rigid + initial)
    center = np.where(missing, halfway, initial)
    center = np.where(missing | fixed, center, middle_of_nested)
    candidates = _Candidates(
        rng=rng,
        nested=reachable(start - center, fixed),
        initial=initial - center,
        rigid=rigid - center,
        missing=missing,
        fixed=fixed,
    )
    return center, candidates


def _fit_separately(
    search: Search, candidates: _Candidates, restarts: int, report: Callable[[], None]
) -> Fit:
    """Fit of every motor by itself; ``report`` is called ``restarts`` times."""
    nested = candidates.nested
    initial = candidates.initial
    fixed = candidates.fixed
    mean = np.where(candidates.missing, candidates.rigid, 0.0)
    prior = single_motor_prior(search, nested, mean, initial).fixing(fixed)

    # start without and with the missing constants
    fit = search.descend(nested, prior, RIGID_STEPS[:1])
    reachable_initial = np.clip(initial, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
    complete = np.where(candidates.missing, reachable_initial, nested)
    fit = fit.better(search.descend(complete, prior, RIGID_STEPS[:1]))

    # Search some motors fully. The prior of the velocity filter depends on the loss. It is
    # estimated again after a quarter of the restarts, since the loss of the simpler motors was
    # larger.
    motors = len(fit.x)
    leaders = np.unique(np.linspace(0, motors - 1, min(LEADERS, motors)).astype(int))
    first_restarts = restarts // 4
    fit = search.until_found_again(
        fit, prior, candidates.draw, first_restarts, STEPS, report, leaders
    )
    prior = single_motor_prior(search, fit.x, prior.mean, initial).fixing(fixed)
    fit = search.until_found_again(
        search.at(fit.x, prior),
        prior,
        candidates.draw,
        restarts - first_restarts,
        STEPS,
        report,
        leaders,
    )

    # the other motors also start from the motors that were searched fully
    followers = np.setdiff1d(search.all_problems, leaders)
    if len(followers):
        leader_x = fit.x[leaders]

        def draw_near_leaders(restart: int, best: Fit) -> np.ndarray:
            return candidates.draw_near(leader_x, restart, best)

        fit = search.until_found_again(
            fit, prior, draw_near_leaders, restarts // 3, STEPS, problems=followers
        )

    prior = single_motor_prior(search, fit.x, prior.mean, initial).fixing(fixed)
    return search.descend(fit.x, prior, ((10, NARROW), (10, FINEST)))
