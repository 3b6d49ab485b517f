"""Errors of a prior on its training motors, against which new motors are tested."""

import math
from dataclasses import replace

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.fit_metrics import (
    RESIDUAL_LEVELS,
    SPEED_POOLS,
    FitMetrics,
    LossStatistics,
)
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder
from motorprior.evaluation.errors import replay_errors
from motorprior.identification.latents.latent_fit import fit_posterior, latent_search
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData, training_data, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import moved, train_test_halves

BLOCK = 1.0  # duration of the blocks that a log is divided into, each with its own mean loss [s]
ASSUMED_GROWTH_STD = 0.4  # standard deviation of log(growth) over motors
ASSUMED_MOTORS = 3.0  # number of motors that the assumption counts as
# half width of a pool's 90 % band below which it is not resolved [rad]
_MIN_RESIDUAL = 1e-5
_SCALE_BOUNDS = (0.1, 20.0)  # of `residual_scale` [-]


def with_training_errors(
    metrics: FitMetrics,
    model: Decoder,
    data: TrainingData,
    recipe: Recipe,
    mean: np.ndarray,
    log: MotorLog,
) -> FitMetrics:
    """The metrics with errors of the training motors at their posterior means (M, Z).

    All fits have ``losses``. Fits in closed loop also have ``residual_percentiles`` of
    `replay_errors` and, if the log has torques, ``losses_without_torque``.
    """
    losses = latent_search(model, data, recipe).observation_losses(mean)
    metrics = replace(metrics, losses=loss_statistics(losses, recipe))
    if recipe.objective != "rollout":
        return metrics

    if data.has_torque:
        without_torque = replace(data, has_torque=False)
        losses = latent_search(model, without_torque, recipe).observation_losses(mean)
        metrics = replace(metrics, losses_without_torque=loss_statistics(losses, recipe))

    errors, velocity = replay_errors(model.motors(mean), log, recipe.nominal_conditions)
    return replace(metrics, residual_percentiles=_percentiles_by_pool(errors, velocity))


def _percentiles_by_pool(errors: np.ndarray, velocity: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Percentiles of the errors at the speeds of each pool; of all errors if the pool is empty."""
    pool = speed_pool(velocity)
    percentiles = []
    for index in range(len(SPEED_POOLS)):
        in_pool = errors[pool == index]
        values = np.percentile(in_pool if len(in_pool) else errors, RESIDUAL_LEVELS)
        percentiles.append(tuple(values.tolist()))
    return tuple(percentiles)


def windows_per_block(recipe: Recipe) -> int:
    """Number of windows in a block."""
    return max(1, round(BLOCK / (recipe.window * recipe.period)))


def loss_statistics(losses: np.ndarray, recipe: Recipe) -> LossStatistics:
    """Statistics of window losses (M, N) in the order of the log."""
    of_motors = losses.mean(axis=1)
    length = windows_per_block(recipe)
    count = losses.shape[1] // length
    whole_blocks = losses[:, : count * length].reshape(len(losses), count, length)
    of_blocks = whole_blocks.mean(axis=2)

    variance = 0.0
    if count > 1:
        variance = np.mean(of_blocks.var(axis=1, ddof=1) / of_blocks.mean(axis=1) ** 2)
    log_std = np.log(of_motors).std(ddof=1) if len(of_motors) > 1 else 0.0
    return LossStatistics(
        mean=float(of_motors.mean()),
        log_mean=float(np.log(of_motors).mean()),
        log_std=float(log_std),
        motors=len(of_motors),
        blocks=float(losses.shape[1] / length),
        block_variance=float(variance),
    )


def speed_pool(joint_vel: np.ndarray) -> np.ndarray:
    """Index into SPEED_POOLS for velocities [rad/s]."""
    return np.searchsorted(list(SPEED_POOLS.values()), np.abs(joint_vel))


def residual_scale(
    percentiles: np.ndarray, errors: np.ndarray, joint_vel: np.ndarray
) -> np.ndarray:
    """(M,) scale of the residuals of M motors [-].

    It is the 90 % quantile of |error| over half the 90 % band of the prior's residuals at the same
    speed.

    Args:
        percentiles: (pools, levels) of the prior's residuals [rad], `FitMetrics.residuals`.
        errors: (T, M) errors of the motors [rad], from `replay_errors`.
        joint_vel: (T, M) simulated velocities [rad/s], which select the speed pool.
    """
    share = np.abs(errors) / half_bands(percentiles)[speed_pool(joint_vel)]
    return np.clip(np.quantile(share, 0.9, axis=0), *_SCALE_BOUNDS)


def half_bands(percentiles: np.ndarray) -> np.ndarray:
    """(pools,) half widths of the 90 % bands [rad] of residuals with these percentiles."""
    width = percentiles[:, RESIDUAL_LEVELS.index(95)] - percentiles[:, RESIDUAL_LEVELS.index(5)]
    return np.maximum(0.5 * width, _MIN_RESIDUAL)


def residual_growth(
    metrics: FitMetrics,
    model: GreyBox,
    mean: np.ndarray,
    classes: ClassLatents,
    log: MotorLog,
    recipe: Recipe,
) -> tuple[float, float]:
    """Growth of residuals from the rows that a motor was fitted to, to later rows.

    The training motors, with latents ``mean`` (M, Z), are adapted to the first half of the log as
    new units of their classes. The growth is the median ratio of their `residual_scale` in the
    second half to the first, at least 1.

    Returns:
        The growth, and the standard deviation of its logarithm over the motors, with
        ASSUMED_GROWTH_STD as ASSUMED_MOTORS more motors.
    """
    halves = train_test_halves(log)
    log_ratio = np.zeros(0)
    shortest = 2.0 * (recipe.history + recipe.window) * recipe.period
    if min(half.duration for half in halves) > shortest:
        first, second = halves
        recipe = with_window_that_fits(recipe, first)
        data = training_data(first, recipe, first.source)
        prior = classes.mean_and_std(classes.of_motors)
        assert metrics.losses is not None
        temperature = metrics.losses.mean
        posterior = fit_posterior(model, data, recipe, temperature, start=mean, prior=prior)

        motors = model.motors(posterior.mean)
        nominal = recipe.nominal_conditions
        percentiles = metrics.residuals
        scale_of_first = residual_scale(percentiles, *replay_errors(motors, first, nominal))
        scale_of_second = residual_scale(percentiles, *replay_errors(motors, second, nominal))
        log_ratio = np.log(scale_of_second / scale_of_first)[moved(first) & moved(second)]

    growth = max(0.0, float(np.median(log_ratio))) if len(log_ratio) else 0.0
    scatter = float(np.sum((log_ratio - growth) ** 2)) + ASSUMED_MOTORS * ASSUMED_GROWTH_STD**2
    return math.exp(growth), math.sqrt(scatter / (len(log_ratio) + ASSUMED_MOTORS))


def aggregate_posterior_kl(mean: np.ndarray, log_var: np.ndarray) -> float:
    """KL divergence of the training motors' posteriors from N(0, I) [nat].

    The posteriors are taken as one normal with the moments of the mixture 1/M·Σᵢ N(μᵢ, σᵢ²). With
    μ = ``mean``, log σ² = ``log_var`` (both (M, Z)), m = avg μ and

        C = diag(avg σ²) + avg (μ - m)(μ - m)ᵀ

    the divergence is (tr C + |m|² - Z - log det C) / 2.
    """
    center = mean.mean(axis=0)
    within = np.diag(np.exp(log_var).mean(axis=0))
    between = (mean - center).T @ (mean - center) / len(mean)
    covariance = within + between
    log_determinant = np.linalg.slogdet(covariance)[1]
    return float(0.5 * (np.trace(covariance) + center @ center - len(center) - log_determinant))
