"""Fit of motors to their logs: every motor alone, or together with a Gaussian over the motors.

Unknowns are the logarithms of the constants (linear where they may be negative), relative to a
central motor; one latent is one output. Each motor alone:

1. Fit the simplest motor: a rigid gear with Coulomb and viscous friction, and a torque limit if it
improves the fit.
   A descent that starts without a limit does not find one.
2. Restart from this optimum with missing constants sampled around the initial motor, from the best
motor so far with a
   random half of its constants resampled, and from other motors' constants. A motor never fits
   worse than a nested one.
3. Stop when the best optimum of each motor was found three times.

Together: a log may not distinguish between optima, such as dry and viscous friction at a constant
speed. A motor without others of its class, whose constants are improbable given those of the other
motors, is therefore searched again, with their Gaussian as its prior. Then empirical Bayes from
these fits (random effects, DerSimonian and Laird, 1986). Each turn updates

    m = median over M motors,   v = (M + 1)/(M - 1)·mean of (x - m)² + mean of diag S;   precision = T / (N·v)
    S = T/N·(G + diag(precision))⁻¹ of every motor,   T the mean loss, G the Gauss-Newton matrix

v is the variance of one more motor: that between the motors, plus the uncertainty of each. A
window, of N, fitted as well as the average one counts as one observation.

Long free runs identify constants that short ones confuse, but a search on them ends in poor optima.
So the search uses short runs, and `refined` takes the last steps on longer ones.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from motorprior.actuator.geared_motor_step import LOG_REACH, PARAMETERS, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import NEGLIGIBLE, constants_of
from motorprior.identification.physics.motor_problem import (
    OFF,
    WEAK,
    centred,
    fixed_constants,
    initial_center,
    motor_search,
    rigid_motor,
    scaled_center,
    separate_prior,
    with_more_terms,
)
from motorprior.identification.physics.window_runs import SPEED_LIMITS, WindowRuns
from motorprior.identification.presets import Recipe
from motorprior.identification.search import FIXED, NARROW, WIDE, Fit, GaussianPrior, Search, Steps
from motorprior.identification.windows import TrainingData

Arrays: TypeAlias = dict[str, np.ndarray]
# (name, compute): computes what is not saved
Checkpoint: TypeAlias = Callable[[str, Callable[[], Arrays]], Arrays]
RIGID_STARTS = 2
RIGID_CANDIDATES = 256
RIGID_RADIUS = 1.5
# maximum number of restarts, and candidates of each
RESTARTS = 48
CANDIDATES = 256
LEADERS = 6  # motors of a fleet that are searched fully; others also start from these
RIGID_STEPS = ((10, WIDE), (6, NARROW))  # descent of the simplest motors
# other descents: the widest differences cross ripples of the loss, which impacts cause
STEPS = ((8, 0.5), (8, 0.2), (8, WIDE), (6, NARROW))
FINEST = 0.01  # step of the differences of the last descent
TURNS = 8  # iterations of empirical Bayes
STAGES = 1 + RESTARTS + TURNS  # number of reports of a fit
SAVING = 0.02  # share of the loss that a limit must save, otherwise it is off
# factors on constants of the initial motor that make its gear stiff. Short velocity filters are not
# tried in this way: that costs two of five mrad in an unseen leg of a real quadruped
STIFF_GEAR = {"gear_stiffness": 140.0, "backlash": 1e-4}
# less than `near_bounds`, which marks constants that the search could not reach
_WITHIN = 0.98 * LOG_REACH
# standard deviation of the logarithm of a constant between classes of a robot: hip, thigh and calf
# of a quadruped differ by 0.8 in armature, 0.7 in Coulomb friction, 0.5 in viscous damping
ASSUMED_BETWEEN = 0.6
# `searched_near_others`: other motors; share of the energy to save
MIN_OTHERS = 3
MIN_ADVANTAGE = 0.05
_MIN_STD = 0.05  # minimum standard deviation over motors of the logarithm of a constant
# `longer_runs`: window [steps], windows, share of rows
LONGER_WINDOW = 200
MIN_LONGER_WINDOWS = 10
MAX_LOST = 0.2
# refinement: wide differences average over ripples, narrow ones find the minimum
REFINEMENT = ((10, WIDE), (10, NARROW), (10, FINEST))
_STREAM = 41


@dataclass(frozen=True)
class MotorFits:
    """A central motor's decoder outputs (K,), and those of M motors relative to it (M, K); their losses (M,)."""

    center: np.ndarray
    offsets: np.ndarray
    loss: np.ndarray
    terms: tuple[str, ...]
    is_rigid: bool = False


def unsaved(name: str, compute: Callable[[], Arrays]) -> Arrays:
    """A `Checkpoint` that saves nothing."""
    return compute()


def fit_motors(
    runs: WindowRuns,
    terms: tuple[str, ...],
    together: bool,
    seed: int,
    report: Callable[[], None] = lambda: None,
    part: WindowRuns | None = None,
    nested: MotorFits | None = None,
    restarts: int = RESTARTS,
) -> MotorFits:
    """Fit all motors of the logs with these optional terms, ``together`` with a Gaussian over them or each alone.

    ``part`` has some of the rows of the ``runs``, for all but the last descents; ``nested`` is a
    fit of simpler motors to start from, `fit_rigid_motors` if not given. ``report`` is called
    STAGES times.
    """
    part = part or runs
    rng = np.random.default_rng([seed, _STREAM])
    fixed = fixed_constants(terms, runs)
    nested = nested or fit_rigid_motors(part, terms, seed)
    start = with_more_terms(nested.center + nested.offsets, nested.terms, terms, runs)
    initial = scaled_center(part, terms)
    rigid, missing = rigid_motor(initial, terms, runs)
    is_new = np.isin(parameters_of(terms), constants_of(set(terms) - set(nested.terms)))
    missing &= is_new | (nested.is_rigid & np.isin(parameters_of(terms), PARAMETERS))
    center = np.where(missing, 0.5 * (rigid + initial), initial)
    report()
    center = np.where(missing | fixed, center, 0.5 * (start.min(axis=0) + start.max(axis=0)))
    search = centred(center, terms, part)
    nested_fit = np.clip(np.where(fixed, 0.0, start - center), -LOG_REACH, LOG_REACH)
    found = _fit_separately(
        search, rng, nested_fit, initial - center, rigid - center, missing, fixed, restarts, report
    )
    if part is not runs:
        search = centred(center, terms, runs)
        prior = separate_prior(search, found.x, found.x, initial - center)
        found = search.descend(found.x, prior.fixing(fixed), STEPS)
    if together and runs.num_motors > MIN_OTHERS:
        found = searched_near_others(search, rng, found, fixed, runs.classes, restarts // 4)
    if together and runs.num_motors > 1:
        found = _empirical_bayes(search, rng, found, fixed, runs.classes, report)
    x = np.where(
        fixed, 0.0, _without_unidentified_limits(search, center, terms, runs, found, fixed)
    )
    # around a centre from which the decoder reaches every motor
    middle = np.clip(np.median(x, axis=0), x.max(axis=0) - LOG_REACH, x.min(axis=0) + LOG_REACH)
    center = center + middle
    x = x - middle
    return MotorFits(center, x, centred(center, terms, runs).losses(x), terms)


def fit_rigid_motors(
    runs: WindowRuns, terms: tuple[str, ...], seed: int, limits: bool = True
) -> MotorFits:
    """The simplest motors: the best of RIGID_STARTS random searches without a torque limit, and as many with one.

    Without ``limits`` the latter are left out; other arguments as for `fit_motors`.
    """
    rng = np.random.default_rng([seed, _STREAM, 1])
    fixed = fixed_constants(terms, runs)
    initial = scaled_center(runs, terms)
    rigid, missing = rigid_motor(initial, terms, runs)
    search = centred(rigid, terms, runs)
    limit = np.array(parameters_of(terms)) == "torque_limit"
    shape = (runs.num_motors, RIGID_CANDIDATES, len(rigid))
    prior = weak = GaussianPrior(np.zeros(len(rigid)), np.full(len(rigid), WEAK))
    found = search.at(np.zeros((runs.num_motors, len(rigid))), weak)
    for frozen in (fixed | missing, fixed | (missing & ~limit))[: 1 + limits]:
        prior = weak.fixing(frozen)
        for _ in range(RIGID_STARTS):
            away = RIGID_RADIUS * rng.standard_normal(shape) * ~frozen
            away[:, :, limit] = -LOG_REACH * rng.random((*shape[:2], 1)) * ~frozen[limit]
            away[:, 0] = 0.0
            best = search.best_of(np.clip(away, -LOG_REACH, LOG_REACH), prior)
            found = found.better(search.descend(best, prior, RIGID_STEPS[:1]))
    found = search.descend(found.x, prior, RIGID_STEPS[1:])
    return MotorFits(
        rigid, np.clip(found.x, -LOG_REACH, LOG_REACH), found.loss, terms, is_rigid=True
    )


def _fit_separately(
    search: Search,
    rng: np.random.Generator,
    nested_fit: np.ndarray,
    initial: np.ndarray,
    rigid: np.ndarray,
    missing: np.ndarray,
    fixed: np.ndarray,
    restarts: int,
    report: Callable[[], None],
) -> Fit:
    """Every motor by itself.

    ``nested_fit`` (M, K) is a fit of motors without the constants ``missing`` (K,); ``initial`` and
    ``rigid`` (K,) are central motors with and without these constants. The constants ``fixed`` (K,)
    are not fitted.
    """
    prior = separate_prior(search, nested_fit, np.where(missing, rigid, 0.0), initial).fixing(fixed)
    shape = (len(nested_fit), CANDIDATES, nested_fit.shape[1])
    gear = PARAMETERS.index("gear_stiffness")

    def draw(restart: int, best: Fit) -> np.ndarray:
        noise = rng.standard_normal(shape)
        kind = restart % 4
        # the simpler motor plus some missing constants; every second time a compliant gear
        if kind == 0:
            around = nested_fit[:, None] + 0.2 * noise * ~missing
            candidates = np.where(
                missing & (rng.random(shape) < 0.5), initial + 1.5 * noise, around
            )
            if restart % 2 == 0 and missing[gear]:
                candidates[..., gear] = 2.0 * initial[gear] - rigid[gear] + 0.5 * noise[..., gear]
        elif kind == 1:  # the best motor, with other constants, or another motor's
            candidates = np.where(
                rng.random(shape) < 0.5, best.x[:, None] + 0.5 * noise, best.x[:, None]
            )
            _add_others(rng, candidates, best.x)
        elif (
            kind == 2
        ):  # the simpler motor, with the initial motor's values of the missing constants
            candidates = np.where(missing, initial + 0.5 * noise, nested_fit[:, None] + 0.3 * noise)
        else:  # any motor
            candidates = np.where(rng.random(shape) < 0.8, initial + 0.7 * noise, best.x[:, None])
        return np.clip(np.where(fixed, 0.0, candidates), -LOG_REACH, LOG_REACH)

    found = search.descend(nested_fit, prior, RIGID_STEPS[:1])
    complete = np.where(missing, np.clip(initial, -LOG_REACH, LOG_REACH), nested_fit)
    found = found.better(search.descend(complete, prior, RIGID_STEPS[:1]))
    leaders = np.unique(np.linspace(0, len(found.x) - 1, min(LEADERS, len(found.x))).astype(int))
    first = restarts // 4
    found = search.until_found_again(found, prior, draw, first, STEPS, report, leaders)
    # the prior of filters is too strong at the simpler motors' loss
    prior = separate_prior(search, found.x, prior.mean, initial).fixing(fixed)
    found = search.until_found_again(
        search.at(found.x, prior), prior, draw, restarts - first, STEPS, report, leaders
    )
    if len(rest := np.setdiff1d(search.all_problems, leaders)):

        def draw_near(restart: int, best: Fit) -> np.ndarray:
            candidates = draw(restart, best)
            known = found.x[leaders][rng.integers(len(leaders), size=shape[:2])]
            near = known + 0.3 * rng.standard_normal(shape) * (rng.random(shape) < 0.5)
            return np.where(fixed, 0.0, near) if restart % 2 == 0 else candidates

        found = search.until_found_again(found, prior, draw_near, restarts // 3, STEPS, which=rest)
    prior = separate_prior(search, found.x, prior.mean, initial).fixing(fixed)
    return search.descend(found.x, prior, ((10, NARROW), (10, FINEST)))


def _add_others(rng: np.random.Generator, candidates: np.ndarray, x: np.ndarray) -> None:
    """Replace up to a quarter of the candidates (M, C, K) of each motor by other motors' constants."""
    for motor in range(len(x)):
        others = rng.permutation(np.delete(np.arange(len(x)), motor))[: candidates.shape[1] // 4]
        candidates[motor, : len(others)] = x[others]


def searched_near_others(
    search: Search,
    rng: np.random.Generator,
    found: Fit,
    fixed: np.ndarray,
    classes: np.ndarray,
    restarts: int,
) -> Fit:
    """The fits; motors without others of their class get another optimum if the other motors make it more probable.

    Their prior is the Gaussian of all other motors, with m = median, s = max(ASSUMED_BETWEEN,
    1.48·median of |x - m|). They are searched with it if Σ (x - m)²/s² > 2·K.
    """
    windows = search.problem.observations
    free = np.count_nonzero(~fixed)
    others = [np.delete(found.x, motor, axis=0) for motor in range(len(found.x))]
    mean = np.median(others, axis=1)
    std = np.maximum(ASSUMED_BETWEEN, 1.48 * np.median(np.abs(others - mean[:, None]), axis=1))
    prior = GaussianPrior(mean, found.loss[:, None] / windows / std**2).fixing(fixed)
    own = search.descend(found.x, prior, RIGID_STEPS[1:])
    is_alone = np.sum(classes[:, None] == classes, axis=1) == 1
    improbable = np.flatnonzero(is_alone & ((own.energy - own.loss) * windows > free * found.loss))

    def draw(restart: int, best: Fit) -> np.ndarray:
        shape = (len(mean), CANDIDATES, len(fixed))
        samples = mean[:, None] + std[:, None] * rng.standard_normal(shape)
        candidates = np.where(rng.random(shape) < 0.5, samples, best.x[:, None])
        return np.clip(np.where(fixed, 0.0, candidates), -LOG_REACH, LOG_REACH)

    other = search.until_found_again(own, prior, draw, restarts, STEPS, which=improbable)
    better = np.flatnonzero(other.energy < (1.0 - MIN_ADVANTAGE) * own.energy)
    return found.replaced(better, other.subset(better))


def _empirical_bayes(
    search: Search,
    rng: np.random.Generator,
    found: Fit,
    fixed: np.ndarray,
    classes: np.ndarray,
    report: Callable[[], None],
) -> Fit:
    """Empirical Bayes in TURNS, from the separate fits."""
    prior = _first_prior(search, found, classes).fixing(fixed)
    for turn in range(TURNS):
        found = search.descend(found.x, prior, ((6, WIDE if turn < 2 else NARROW),))
        if turn < 4:
            std = np.sqrt(found.loss.mean() / search.problem.observations / prior.precision)
            shape = (len(found.x), CANDIDATES, found.x.shape[1])
            mean = np.broadcast_to(prior.mean, found.x.shape)[:, None]
            samples = mean + std * rng.standard_normal(shape)
            candidates = np.where(rng.random(shape) < 0.5, samples, found.x[:, None])
            _add_others(rng, candidates, found.x)
            other = search.best_of(
                np.clip(np.where(fixed, 0.0, candidates), -LOG_REACH, LOG_REACH), prior
            )
            found = found.better(search.descend(other, prior, ((6, WIDE),)))
        variance = posterior_variance(search, found, prior)
        prior = population_prior(found, search.problem.observations, variance, classes).fixing(
            fixed
        )
        report()
    return found


def _first_prior(search: Search, found: Fit, classes: np.ndarray) -> GaussianPrior:
    """Gaussian over motors that were fitted separately, by random effects: uncertain constants count less.

    Two steps of v = (Σ w·(x - m)² - Σ w·s² + Σ w²·s²/Σ w) / (Σ w - Σ w²/Σ w), w = 1/(v + s²), m = Σ
    w·x/Σ w. Several ``classes`` (M,) have an m each; the sums of numerator and denominator are over
    the classes.
    """
    windows = search.problem.observations
    motors = len(found.x)
    information = search.curvatures(found.x, WIDE) * windows / found.loss[:, None, None]
    # unidentifiable constants have a standard deviation of 10
    floor = 1e-2 * np.eye(found.x.shape[1])
    s2 = np.einsum("mkk->mk", np.linalg.inv(information + floor))
    m = found.x.copy()
    v = np.zeros(found.x.shape[1])
    groups = [classes == each for each in np.unique(classes)]
    for _ in range(3):
        spread, total = np.zeros((2, *v.shape))
        for group in groups:
            x = found.x[group]
            s = s2[group]
            w = 1.0 / (v + s)
            m[group] = (w * x).sum(axis=0) / w.sum(axis=0)
            spread += (w * (x - m[group]) ** 2).sum(axis=0) - (w * s).sum(axis=0)
            spread += (w**2 * s).sum(axis=0) / w.sum(axis=0)
            total += w.sum(axis=0) - (w**2).sum(axis=0) / w.sum(axis=0)
        v = np.maximum(0.0, spread / np.maximum(total, 1e-12))
    variance = np.maximum(v * (motors + 1) / motors, _MIN_STD**2)
    return GaussianPrior(m, found.loss.mean() / windows / variance)


def posterior_variance(search: Search, found: Fit, prior: GaussianPrior) -> np.ndarray:
    """(K,) posterior variance of a motor's x, mean over the motors."""
    scale = search.problem.observations / found.loss.mean()
    precision = (search.curvatures(found.x) + np.diag(prior.precision)) * scale
    return np.einsum("mkk->mk", np.linalg.inv(precision)).mean(axis=0)


def population_prior(
    found: Fit, windows: int, variance: np.ndarray | float, classes: np.ndarray
) -> GaussianPrior:
    """Gaussian of one more motor of each motor's class (M,); ``variance`` (K,) is that of `posterior_variance`.

    With several classes, m is the median of each class and v is pooled over the classes, with M - C
    for M - 1.
    """
    mean = np.empty_like(found.x)
    motors = len(found.x)
    names = np.unique(classes)
    for each in names:
        mean[classes == each] = np.median(found.x[classes == each], axis=0)
    spread = (motors + 1) / max(1, motors - len(names)) * np.mean((found.x - mean) ** 2, axis=0)
    variance = np.maximum(spread + variance, _MIN_STD**2)
    return GaussianPrior(mean, found.loss.mean() / windows / variance)


def _without_unidentified_limits(
    search: Search,
    center: np.ndarray,
    terms: tuple[str, ...],
    runs: WindowRuns,
    found: Fit,
    fixed: np.ndarray,
) -> np.ndarray:
    """(M, K) unknowns whose limits are off, OFF times the largest request or speed, where they save less than SAVING.

    With lower limits the motor could saturate in other motions. A profile without a limit of
    acceleration has that of `NEGLIGIBLE`.
    """
    x = np.clip(found.x, -LOG_REACH, LOG_REACH)
    names = parameters_of(terms)
    kp = names.index("kp")
    requested_torque = np.exp(center[kp] + x[:, kp]) * runs.max_request
    values = {"torque_limit": OFF * requested_torque.max()} | dict.fromkeys(
        SPEED_LIMITS, OFF * runs.max_speed
    )
    values["profile_acceleration"] = NEGLIGIBLE["profile_acceleration"]
    for name, value in values.items():
        if name in names and value:
            row = names.index(name)
            off = {row: np.clip(np.log(value) - center[row], x[:, row], LOG_REACH)}
            x = _fixed_unless_identified(
                search, x, fixed, off, RIGID_STEPS[1:], search.all_problems, SAVING
            )
    return x


def with_stiff_gears(model: GreyBox, x: np.ndarray, runs: WindowRuns) -> np.ndarray:
    """(M, K) latents with stiff gears without backlash, in classes that fit better with them.

    Else a compliance that the logs do not show takes a part of the delay, which is then too short.
    The motors of a class decide together: the mean of stiff and compliant gears is neither.
    """
    terms = model.terms
    initial = initial_center(terms, runs) - model.center
    fixed = fixed_constants(terms, runs)
    rows = {PARAMETERS.index(name): np.log(factor) for name, factor in STIFF_GEAR.items()}
    off = {row: np.clip(initial[row] + factor, -_WITHIN, _WITHIN) for row, factor in rows.items()}
    return _fixed_unless_identified(
        motor_search(model, runs), x, fixed, off, STEPS[1:], runs.classes, cost=0.0
    )


def _fixed_unless_identified(
    search: Search,
    x: np.ndarray,
    fixed: np.ndarray,
    off: dict[int, Any],
    steps: Steps,
    groups: np.ndarray,
    cost: float,
) -> np.ndarray:
    """(M, K) unknowns with the rows ``off``, and a descent of the others, in groups of motors where it costs little.

    ``off`` has (M,) values or one value per row, ``groups`` are (M,), and ``cost`` is the largest
    mean growth of the loss; unknowns stay where a row is fixed.
    """
    if fixed[list(off)].any():
        return x
    free = x.copy()
    frozen = fixed.copy()
    for row, values in off.items():
        free[:, row] = values
        frozen[row] = True
    prior = GaussianPrior(free, np.broadcast_to(np.where(frozen, FIXED, WEAK), x.shape))
    changed = search.descend(free, prior, steps)
    growth = np.log(changed.loss / search.at(x, prior).loss)
    allowed = [growth[groups == group].mean() <= -np.log(1.0 - cost) for group in groups]
    return np.where(np.array(allowed)[:, None], changed.x, x)


def longer_runs(data: TrainingData, recipe: Recipe, runs: WindowRuns) -> WindowRuns:
    """Free runs of about LONGER_WINDOW steps, or ``runs``, those of the recipe, if they are as long.

    Returns ``runs``, too, if longer windows lose more than MAX_LOST of the rows or are fewer than
    MIN_LONGER_WINDOWS.
    """
    lengths = np.array([part.stop - part.start - 1 - recipe.history for part in data.parts])
    length = int(np.median(lengths[lengths >= recipe.window]))
    window = length // max(1, round(length / LONGER_WINDOW))
    if window <= recipe.window:
        return runs
    longer = WindowRuns(data, replace(recipe, window=window))
    enough = longer.windows * window >= (1.0 - MAX_LOST) * runs.windows * recipe.window
    return longer if enough and longer.windows >= MIN_LONGER_WINDOWS else runs


def refined(model: GreyBox, x: np.ndarray, runs: WindowRuns, together: bool) -> np.ndarray:
    """(M, K) latents after Gauss-Newton steps from ``x`` on ``runs``, longer than those of the fit.

    The prior is the fleet's if ``together``, estimated at x; otherwise `separate_prior` around x.
    """
    search = motor_search(model, runs)
    terms = model.terms
    windows = runs.windows
    fixed = fixed_constants(terms, runs)
    initial = initial_center(terms, runs) - model.center
    prior = separate_prior(search, x, x, initial).fixing(fixed)
    if together and len(x) > 1:
        found = search.at(x, prior)
        first = population_prior(found, windows, 0.0, runs.classes).fixing(fixed)
        variance = posterior_variance(search, found, first)
        prior = population_prior(found, windows, variance, runs.classes).fixing(fixed)
    prior = replace(prior, mean=np.where(fixed, x, prior.mean))
    return np.where(
        fixed, x, np.clip(search.descend(x, prior, REFINEMENT).x, -LOG_REACH, LOG_REACH)
    )
