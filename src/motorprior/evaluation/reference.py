"""Reference statistics of a prior's errors on its training motors, against which new motors are tested."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import Decoder
from motorprior.evaluation.errors import replay_errors
from motorprior.identification.latents.latent_fit import fit_posterior, latent_search
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData, training_data, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import moved, train_test_halves

LEVELS = tuple(range(5, 100, 5))  # percentiles of the closed-loop residual that are saved [%]
# upper bound of the joint's speed in each pool of residuals [rad/s]; residuals grow with speed
SPEEDS = {"slow": 0.3, "medium": 2.0, "fast": math.inf}
BLOCK = 1.0  # duration of the blocks that a log is divided into, each with its own mean loss [s]
# metrics: `residual_growth`
GROWTH = "held_out_growth"
GROWTH_STD = "held_out_growth_std"
ASSUMED_GROWTH_STD = 0.4  # standard deviation of log(growth) over motors
# [rad]; bounds of `residual_scale`
_MIN_RESIDUAL = 1e-5
_MISFIT = (0.1, 20.0)
WITHOUT_TORQUE = "_without_torque"  # suffix of the metrics' names for logs without torques
LOSS_METRICS = ("mean", "log_mean", "log_std", "motors", "pieces", "piece_variance")


def reference_metrics(
    model: Decoder, data: TrainingData, preset: Recipe, mean: np.ndarray, log: MotorLog
) -> dict[str, float]:
    """Errors of the training motors at their posterior means.

    loss_mean                      mean window loss of all motors
    loss_log_mean, loss_log_std    mean and standard deviation over motors of log(mean window loss of a motor)
    loss_motors, loss_pieces       number of motors, and of blocks per motor
    loss_piece_variance            variance of the blocks' mean losses within a motor, over its mean loss squared
    residual_p05_SPEED … p95       percentiles of `replay_errors` by pool of SPEEDS, for priors trained in closed loop

    If the log has torques, losses with the suffix WITHOUT_TORQUE are added, for new motors whose
    log has none.
    """
    metrics = loss_metrics(latent_search(model, data, preset).observation_losses(mean), preset, "")
    if preset.objective == "rollout":
        if data.has_torque:
            without = replace(data, has_torque=False)
            metrics |= loss_metrics(
                latent_search(model, without, preset).observation_losses(mean),
                preset,
                WITHOUT_TORQUE,
            )
        errors, velocity = replay_errors(model.motors(mean), log, preset.nominal_conditions)
        pool = speed_pool(velocity)
        for index, name in enumerate(SPEEDS):
            chosen = errors[pool == index]
            values = np.percentile(chosen if len(chosen) else errors, LEVELS)
            metrics |= dict(zip(percentile_names(name), values.tolist(), strict=True))
    return metrics


def windows_per_block(preset: Recipe) -> int:
    """Number of windows in a block."""
    return max(1, round(BLOCK / (preset.window * preset.period)))


def loss_metrics(losses: np.ndarray, preset: Recipe, suffix: str) -> dict[str, float]:
    """The ``loss_…`` of `reference_metrics`, from window losses (M, N) in the order of the log."""
    motor = losses.mean(axis=1)
    length = windows_per_block(preset)
    count = losses.shape[1] // length
    blocks = losses[:, : count * length].reshape(len(losses), count, length).mean(axis=2)
    within = np.mean(blocks.var(axis=1, ddof=1) / blocks.mean(axis=1) ** 2) if count > 1 else 0.0
    std = np.log(motor).std(ddof=1) if len(motor) > 1 else 0.0
    values = (motor.mean(), np.log(motor).mean(), std, len(motor), losses.shape[1] / length, within)
    return {
        f"loss_{name}{suffix}": float(value)
        for name, value in zip(LOSS_METRICS, values, strict=True)
    }


def percentile_names(pool: str) -> list[str]:
    """Names of a pool's residual metrics, in the order of LEVELS."""
    return [f"residual_p{level:02d}_{pool}" for level in LEVELS]


def speed_pool(joint_vel: np.ndarray) -> np.ndarray:
    """Index into SPEEDS for velocities [rad/s]."""
    return np.searchsorted(list(SPEEDS.values()), np.abs(joint_vel))


def residual_scale(
    metrics: Mapping[str, float], errors: np.ndarray, joint_vel: np.ndarray
) -> np.ndarray:
    """(M,) scale of the residuals of M motors: the 90 % quantile of |error| over half the pool's 90 % band.

    ``errors`` [rad] and simulated ``joint_vel`` [rad/s] are (T, M), from `replay_errors`; the speed
    selects the pool.
    """
    half = [
        0.5 * (metrics[f"residual_p95_{name}"] - metrics[f"residual_p05_{name}"]) for name in SPEEDS
    ]
    share = np.abs(errors) / np.maximum(np.array(half)[speed_pool(joint_vel)], _MIN_RESIDUAL)
    return np.clip(np.quantile(share, 0.9, axis=0), *_MISFIT)


def residual_growth(
    model: GreyBox,
    mean: np.ndarray,
    classes: ClassLatents,
    log: MotorLog,
    preset: Recipe,
    metrics: Mapping[str, float],
) -> dict[str, float]:
    """How much residuals grow from the rows that a motor was fitted to, to later rows: metrics GROWTH and GROWTH_STD.

    The training motors, with latents ``mean`` (M, Z), are adapted to the first half of the log as
    new units of their classes. The growth is the median ratio of their `residual_scale` in the
    second half to that in the first, at least 1; its logarithm has a standard deviation over the
    motors, with ASSUMED_GROWTH_STD as three more motors.
    """
    first, rest = train_test_halves(log)
    ratio = np.zeros(0)
    if min(first.duration, rest.duration) > 2.0 * (preset.history + preset.window) * preset.period:
        preset = with_window_that_fits(preset, first)
        data = training_data(first, preset, first.source)
        prior = classes.mean_and_std(classes.of_motors)
        found = fit_posterior(model, data, preset, metrics["loss_mean"], start=mean, prior=prior)
        motors = model.motors(found.mean)
        nominal = preset.nominal_conditions
        own, later = (
            residual_scale(metrics, *replay_errors(motors, part, nominal)) for part in (first, rest)
        )
        ratio = np.log(later / own)[moved(first) & moved(rest)]
    growth = max(0.0, float(np.median(ratio))) if len(ratio) else 0.0
    scatter = float(np.sum((ratio - growth) ** 2)) + 3.0 * ASSUMED_GROWTH_STD**2
    return {GROWTH: math.exp(growth), GROWTH_STD: math.sqrt(scatter / (len(ratio) + 3.0))}


def aggregate_posterior_kl(mean: np.ndarray, log_var: np.ndarray) -> float:
    """KL divergence from N(0, I) of a normal with the moments of the mixture 1/M·Σᵢ N(μᵢ, σᵢ²) [nat].

    With μ = ``mean``, log σ² = ``log_var`` (both (M, Z)), m = avg μ, C = diag(avg σ²) + avg (μ -
    m)(μ - m)ᵀ it is (tr C + |m|² - Z - log det C) / 2.
    """
    center = mean.mean(axis=0)
    covariance = np.diag(np.exp(log_var).mean(axis=0)) + (mean - center).T @ (mean - center) / len(
        mean
    )
    log_determinant = np.linalg.slogdet(covariance)[1]
    return float(0.5 * (np.trace(covariance) + center @ center - len(center) - log_determinant))
