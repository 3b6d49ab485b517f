"""Profiles of the loss: other motors that replay the logs as well as the fit.

The joint covariance of `estimate_uncertainty` is of the loss near the fit. Constants that trade
with each other can be far away from the fit at almost the same loss, in a valley with many local
optima. Other fits find them:

- A constant that seems identified is fixed at the ends of its interval, and the others are fitted
  again. They start where the joint covariance expects them. If kp is fitted, they also start where
  all torques have the same factor as the constant.
- The play of a gear is not fitted if the encoders are on the rotors. All constants are fitted again
  with other plays.

A fit whose loss is larger by at most MODEL_ERROR must be within SCORE of the joint covariance, so
that all intervals have its constants. It is added to the covariance otherwise (`with_fit`).
"""

from dataclasses import replace

import numpy as np

from motorprior.actuator.estimates import SCORE, Estimates, is_identified, value_at
from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import SIGNED
from motorprior.identification.physics.estimate_coordinates import Coordinates
from motorprior.identification.physics.motor_problem import (
    TORQUES,
    WEAK_PRECISION,
    fixed_constants,
    motor_search,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.search import FIXED, NARROW, WIDE, Fit, GaussianPrior, Search

# Share by which the loss may rise within a 90 % interval. Chosen on simulated arms other than those
# of the reported coverage (benchmarks/simulated_arms.py).
MODEL_ERROR = 0.07
MAX_PROFILE_FACTOR = 10.0  # maximum factor of a profile on a standard deviation
# Plays [rad] that are tried with encoders on the rotors: from half of the initial motor's to none
# and back, and its double. Each row starts from the fit, and each play from the play before it. On
# the way back, constants may be in another valley.
PLAYS = ((0.0075, 0.00375, 0.0001, 0.00375, 0.0075), (0.03,))
_STEPS = ((6, WIDE), (4, NARROW))


def profiled(
    search: Search,
    coordinates: Coordinates,
    estimates: Estimates,
    free: np.ndarray,
    losses: np.ndarray,
) -> Estimates:
    """The estimates with larger standard deviations where a profile of the loss is flatter.

    ``free`` are the columns of the fitted constants, ``losses`` (M,) those of the fit.
    """
    factors = np.ones_like(coordinates.x)
    fits = []
    for column in free:
        motors = np.flatnonzero(_seems_identified(coordinates, estimates, column))
        if not len(motors):
            continue
        for sign in (1.0, -1.0):
            change = sign * SCORE * np.sqrt(estimates.covariance[:, column, column])
            starts = _starts(coordinates, estimates, free, column, change)
            is_fixed = ~np.isin(np.arange(len(coordinates.names)), free)
            is_fixed[column] = True
            fits_at_end = [refitted(search, start, is_fixed, motors) for start in starts]
            fits += [(motors, fit) for fit in fits_at_end]

            rises = np.min([fit.loss for fit in fits_at_end], axis=0) - losses[motors]
            _, real_change = coordinates.moved(column, change)
            # the end of an interval that the decoder cannot reach is checked nearer by, or not
            share = (real_change[motors] / change[motors]) ** 2
            factor = _profile_factor(rises, MODEL_ERROR * losses[motors] * share)
            factors[motors, column] = np.maximum(factors[motors, column], factor)

    covariance = factors[:, :, None] * estimates.covariance * factors[:, None, :]
    estimates = Estimates(covariance, estimates.scale)
    for motors, fit in fits:
        estimates = with_fit(estimates, coordinates, free, losses, fit, motors)
    return estimates


def with_other_plays(
    model: GreyBox,
    runs: WindowRuns,
    coordinates: Coordinates,
    estimates: Estimates,
    free: np.ndarray,
    losses: np.ndarray,
) -> Estimates:
    """The estimates with fits that have other PLAYS of the gears, see the module docstring."""
    fixed = fixed_constants(model.terms, runs)
    motors = np.arange(len(coordinates.x))
    column = coordinates.names.index("backlash")
    for plays in PLAYS:
        x = coordinates.x
        for play in plays:
            center = model.center.copy()
            center[column] = np.log(play)
            search = motor_search(replace(model, center=center), runs)
            fit = refitted(search, x, fixed, motors)
            estimates = with_fit(estimates, coordinates, free, losses, fit, motors)
            x = fit.x
    return estimates


def with_fit(
    estimates: Estimates,
    coordinates: Coordinates,
    free: np.ndarray,
    losses: np.ndarray,
    fit: Fit,
    motors: np.ndarray,
) -> Estimates:
    """The estimates, of which another fit is within SCORE if its loss is almost that of ``losses``.

    With the change d of the coordinates y (of the constants ``free``) and the distance
    D = dᵀ·C⁻¹·d > SCORE², the covariance becomes C + (1/SCORE² - 1/D)·d·dᵀ, in which D is SCORE².
    ``fit`` is of the ``motors`` (m,).
    """
    x = coordinates.x.copy()
    x[motors] = fit.x
    changes = coordinates.changes(x)[:, free]
    covariance = estimates.covariance.copy()
    for motor, loss in zip(motors, fit.loss, strict=True):
        if loss > (1.0 + MODEL_ERROR) * losses[motor]:
            continue
        of_free = np.ix_(free, free)
        change = changes[motor]
        distance = change @ np.linalg.solve(covariance[motor][of_free], change)
        if distance > SCORE**2:
            growth = 1.0 / SCORE**2 - 1.0 / distance
            covariance[motor][of_free] += growth * np.outer(change, change)
    return Estimates(covariance, estimates.scale)


def refitted(search: Search, start: np.ndarray, is_fixed: np.ndarray, motors: np.ndarray) -> Fit:
    """Fit of ``motors`` (m,) after steps from ``start`` (M, K), with fixed unknowns (K,)."""
    precision = np.where(is_fixed, FIXED, WEAK_PRECISION)
    prior = GaussianPrior(start, np.broadcast_to(precision, start.shape))
    return search.descend(start[motors], prior, _STEPS, motors)


def profile_rises(
    model: GreyBox, z: np.ndarray, runs: WindowRuns, factor: float, motors: np.ndarray
) -> dict[str, np.ndarray]:
    """(2, m) relative rises of the loss if a fitted positive constant is changed, by its name.

    The constant of ``motors`` (m indices) is divided by ``factor``, or multiplied by it, and the
    others are fitted again. ``z`` (M, Z) are the latents of all motors and ``runs`` their logs.
    """
    x = model.decoder_latents(z)
    search = motor_search(replace(model, copula=None), runs)
    losses = search.losses(x)
    fixed = fixed_constants(model.terms, runs)
    rises = {}
    for column, name in enumerate(parameters_of(model.terms)):
        if fixed[column] or name in SIGNED:
            continue
        is_fixed = fixed | (np.arange(len(fixed)) == column)
        both = []
        for change in (-np.log(factor), np.log(factor)):
            start = x.copy()
            start[:, column] = np.clip(x[:, column] + change, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
            both.append(refitted(search, start, is_fixed, motors).loss)
        rises[name] = np.stack(both) / losses[motors] - 1.0
    return rises


def _seems_identified(coordinates: Coordinates, estimates: Estimates, column: int) -> np.ndarray:
    """(M,) whether the marginal interval of a constant identifies it."""
    name = coordinates.names[column]
    scale = coordinates.scale_of(column)
    y = coordinates.of_fit(column)
    reach = SCORE * np.sqrt(estimates.covariance[:, column, column])
    ends = np.stack([value_at(name, y - reach, scale), value_at(name, y + reach, scale)])
    return is_identified(name, np.sort(ends, axis=0))


def _starts(
    coordinates: Coordinates,
    estimates: Estimates,
    free: np.ndarray,
    column: int,
    change: np.ndarray,
) -> list[np.ndarray]:
    """Unknowns (M, K) with the coordinate of one constant moved by ``change`` (M,).

    The others follow as the covariance expects. Of a torque, all torques also follow in proportion,
    if kp is fitted.
    """
    moved, real_change = coordinates.moved(column, change)
    expected = coordinates.x.copy()
    expected[:, column] = moved
    variance = estimates.covariance[:, column, column]
    for other in free:
        if other != column:
            slope = estimates.covariance[:, other, column] / variance
            follows = np.clip(slope * real_change, -1.0, 1.0)
            expected[:, other], _ = coordinates.moved(other, follows)

    names = np.array(coordinates.names)
    is_scaled = np.isin(names, TORQUES) & np.isin(np.arange(len(names)), free)
    if not (is_scaled[column] and is_scaled[coordinates.names.index("kp")]):
        return [expected]
    log_factor = moved - coordinates.x[:, column]
    scaled = coordinates.x + log_factor[:, None] * is_scaled
    return [expected, np.clip(scaled, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)]


def _profile_factor(rises: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(m,) factor on standard deviations, from rises of the loss and the expected ones (m,)."""
    is_checked = expected > 0.0
    ratio = np.where(is_checked, rises / np.where(is_checked, expected, 1.0), 1.0)
    return np.maximum(ratio, MAX_PROFILE_FACTOR**-2) ** -0.5
