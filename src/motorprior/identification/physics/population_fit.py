"""Fit of motors together, with a Gaussian over the motors as their prior.

A log may not distinguish between optima, such as dry and viscous friction at a constant speed. A
motor without others of its class, whose constants are improbable given the other motors, is
therefore searched again, with the Gaussian of the other motors as its prior
(`searched_near_others`).

Then empirical Bayes from these fits (random effects, DerSimonian and Laird, 1986). Each turn
updates

    m = median over M motors
    v = (M + 1)/(M - 1)·mean of (x - m)² + mean of diag S,     precision = T / (N·v)
    S = T/N·(G + diag(precision))⁻¹ of every motor

with the mean loss T, the Gauss-Newton matrix G, and N windows per motor. v is the variance of one
more motor: the variance between the motors, plus the mean uncertainty of a motor. A window that is
fitted as well as the average window counts as one observation.
"""

from collections.abc import Callable

import numpy as np

from motorprior.identification.physics.descents import (
    CANDIDATES,
    RIGID_STEPS,
    STEPS,
    add_other_motors,
    half_resampled,
    reachable,
)
from motorprior.identification.search import NARROW, WIDE, Fit, GaussianPrior, Search, Steps

TURNS = 8  # iterations of empirical Bayes
# iterations with wide differences, and iterations with new candidates
_WIDE_TURNS = 2
_SEARCHING_TURNS = 4
# standard deviation of the logarithm of a constant between classes of a robot: hip, thigh and calf
# of a quadruped differ by 0.8 in armature, 0.7 in Coulomb friction, 0.5 in viscous damping
ASSUMED_BETWEEN = 0.6
# `searched_near_others`: minimum number of other motors, and share of the energy to save
MIN_OTHERS = 3
MIN_ADVANTAGE = 0.05
_MIN_STD = 0.05  # minimum standard deviation over motors of the logarithm of a constant


def searched_near_others(
    search: Search,
    rng: np.random.Generator,
    fit: Fit,
    fixed: np.ndarray,
    classes: np.ndarray,
    restarts: int,
) -> Fit:
    """The fit, in which lone motors may have another optimum that the other motors suggest.

    A lone motor has no others of its class. Its prior is the Gaussian of all other motors, with m =
    median and s = max(ASSUMED_BETWEEN, 1.48·median of |x - m|). It is searched with this prior if
    Σ (x - m)²/s² > 2·K, and gets the new optimum if that saves MIN_ADVANTAGE of the energy.

    Args:
        search: of the motors' problems.
        rng: for the candidates.
        fit: of every motor by itself.
        fixed: (K,) mask of the constants that are not fitted.
        classes: (M,) index of each motor's class.
        restarts: maximum number.
    """
    windows = search.problem.observations
    num_free = np.count_nonzero(~fixed)

    # (M, M - 1, K) constants of the other motors, and their Gaussian, (M, K)
    other_motors = np.stack([np.delete(fit.x, motor, axis=0) for motor in range(len(fit.x))])
    mean = np.median(other_motors, axis=1)
    deviation = np.median(np.abs(other_motors - mean[:, None]), axis=1)
    std = np.maximum(ASSUMED_BETWEEN, 1.48 * deviation)
    prior = GaussianPrior(mean, fit.loss[:, None] / windows / std**2).fixing(fixed)

    # the motors' own optima with this prior, and those that are improbable under it
    current = search.descend(fit.x, prior, RIGID_STEPS[1:])
    is_alone = np.sum(classes[:, None] == classes, axis=1) == 1
    is_improbable = (current.energy - current.loss) * windows > num_free * fit.loss
    searched = np.flatnonzero(is_alone & is_improbable)

    def draw(restart: int, best: Fit) -> np.ndarray:
        shape = (len(mean), CANDIDATES, len(fixed))
        samples = mean[:, None] + std[:, None] * rng.standard_normal(shape)
        return reachable(half_resampled(rng, samples, best), fixed)

    near_others = search.until_found_again(current, prior, draw, restarts, STEPS, problems=searched)
    improved = np.flatnonzero(near_others.energy < (1.0 - MIN_ADVANTAGE) * current.energy)
    return fit.replaced(improved, near_others.subset(improved))


def empirical_bayes(
    search: Search,
    rng: np.random.Generator,
    fit: Fit,
    fixed: np.ndarray,
    classes: np.ndarray,
    report: Callable[[], None],
) -> Fit:
    """Fit with a Gaussian over the motors, in TURNS from the separate fits.

    Arguments as for `searched_near_others`; ``report`` is called once per turn.
    """
    windows = search.problem.observations
    prior = _first_prior(search, fit, classes).fixing(fixed)
    for turn in range(TURNS):
        diff_step = WIDE if turn < _WIDE_TURNS else NARROW
        fit = search.descend(fit.x, prior, ((6, diff_step),))

        # early turns also try samples of the prior and other motors' constants
        if turn < _SEARCHING_TURNS:
            std = np.sqrt(fit.loss.mean() / windows / prior.precision)
            fit = fit_from_samples(search, rng, fit, prior, std, fixed, ((6, WIDE),))

        variance = posterior_variance(search, fit, prior)
        prior = population_prior(fit, windows, variance, classes).fixing(fixed)
        report()
    return fit


def fit_from_samples(
    search: Search,
    rng: np.random.Generator,
    fit: Fit,
    prior: GaussianPrior,
    std: np.ndarray,
    fixed: np.ndarray,
    steps: Steps,
) -> Fit:
    """The better one of a fit and of descents from samples of its prior.

    In a sample, a random half of the unknowns is from the prior's mean with the standard deviations
    ``std`` (K,), the others are from the fit. Other motors' unknowns are candidates, too.
    """
    mean = np.broadcast_to(prior.mean, fit.x.shape)[:, None]
    shape = (len(fit.x), CANDIDATES, fit.x.shape[1])
    samples = mean + std * rng.standard_normal(shape)
    candidates = half_resampled(rng, samples, fit)
    add_other_motors(rng, candidates, fit.x)
    start = search.best_of(reachable(candidates, fixed), prior)
    return fit.better(search.descend(start, prior, steps))


def _first_prior(search: Search, fit: Fit, classes: np.ndarray) -> GaussianPrior:
    """Gaussian over motors that were fitted separately, by random effects.

    Uncertain constants count less, with s² the variance of a motor's own fit. Three steps of

        v = (Σ w·(x - m)² - Σ w·s² + Σ w²·s²/Σ w) / (Σ w - Σ w²/Σ w)
        w = 1/(v + s²),   m = Σ w·x/Σ w

    from v = 0. Each of the ``classes`` (M,) has an m of its own; the sums of numerator and
    denominator are over the classes.
    """
    windows = search.problem.observations
    motors = len(fit.x)
    size = fit.x.shape[1]

    information = search.curvatures(fit.x, WIDE) * windows / fit.loss[:, None, None]
    # unidentifiable constants have a standard deviation of 10
    floor = 1e-2 * np.eye(size)
    fit_variance = np.einsum("mkk->mk", np.linalg.inv(information + floor))  # (M, K)

    mean = fit.x.copy()
    between = np.zeros(size)  # v
    class_masks = [classes == index for index in np.unique(classes)]
    for _ in range(3):
        numerator = np.zeros(size)
        denominator = np.zeros(size)
        for mask in class_masks:
            x = fit.x[mask]
            s2 = fit_variance[mask]
            w = 1.0 / (between + s2)
            sum_w = w.sum(axis=0)
            mean[mask] = (w * x).sum(axis=0) / sum_w
            numerator += (w * (x - mean[mask]) ** 2).sum(axis=0) - (w * s2).sum(axis=0)
            numerator += (w**2 * s2).sum(axis=0) / sum_w
            denominator += sum_w - (w**2).sum(axis=0) / sum_w
        between = np.maximum(0.0, numerator / np.maximum(denominator, 1e-12))

    # of one more motor
    variance = np.maximum(between * (motors + 1) / motors, _MIN_STD**2)
    return GaussianPrior(mean, fit.loss.mean() / windows / variance)


def posterior_variance(search: Search, fit: Fit, prior: GaussianPrior) -> np.ndarray:
    """(K,) posterior variance of a motor's unknowns, mean over the motors."""
    scale = search.problem.observations / fit.loss.mean()
    precision = (search.curvatures(fit.x) + np.diag(prior.precision)) * scale
    return np.einsum("mkk->mk", np.linalg.inv(precision)).mean(axis=0)


def population_prior(
    fit: Fit, windows: int, variance: np.ndarray | float, classes: np.ndarray
) -> GaussianPrior:
    """Gaussian of one more motor of each motor's class.

    With several ``classes`` (M,), m is the median of each class and v is pooled over the classes,
    with M - C for M - 1. ``variance`` (K,) is the mean uncertainty of a motor, of
    `posterior_variance`; ``windows`` is N.
    """
    mean = np.empty_like(fit.x)
    motors = len(fit.x)
    class_indices = np.unique(classes)
    for index in class_indices:
        mean[classes == index] = np.median(fit.x[classes == index], axis=0)

    freedom = max(1, motors - len(class_indices))
    between = (motors + 1) / freedom * np.mean((fit.x - mean) ** 2, axis=0)
    total = np.maximum(between + variance, _MIN_STD**2)
    return GaussianPrior(mean, fit.loss.mean() / windows / total)
