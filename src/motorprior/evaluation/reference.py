"""Reference statistics of a prior's errors on its training motors, against which new motors are tested."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.joint_classes import JointClasses
from motorprior.actuator.motor_prior import Decoder
from motorprior.evaluation.errors import replay_errors
from motorprior.identification.latents.latent_fit import fit_posterior, latent_search
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData, training_data, with_window_that_fits
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import moved
from motorprior.logs.splits import train_test_halves

LEVELS = tuple(range(5, 100, 5))  # percentiles of the closed-loop residual that are saved [%]
# upper bound of the joint's speed in each pool of residuals [rad/s]; residuals grow with speed
SPEEDS = {"slow": 0.3, "medium": 2.0, "fast": math.inf}
BLOCK = 1.0  # duration of the blocks that a log is divided into, each with its own mean loss [s]
GROWTH, GROWTH_STD = "held_out_growth", "held_out_growth_std"  # metrics: `residual_growth`
ASSUMED_GROWTH_STD = 0.4  # standard deviation of log(growth) over motors
_MIN_RESIDUAL, _MISFIT = 1e-5, (0.1, 20.0)  # [rad]; bounds of `residual_scale`
WITHOUT_TORQUE = "_without_torque"  # suffix of the metrics' names for logs without torques
_LOSS_METRICS = ("mean", "log_mean", "log_std", "motors", "pieces", "piece_variance")


def reference_metrics(
    model: Decoder, data: TrainingData, preset: Preset, mean: np.ndarray, log: MotorLog
) -> dict[str, float]:
    """Errors of the training motors at their posterior means.

    loss_mean                      mean window loss of all motors
    loss_log_mean, loss_log_std    mean and standard deviation over motors of log(mean window loss of a motor)
    loss_motors, loss_pieces       number of motors, and of blocks per motor
    loss_piece_variance            variance of the blocks' mean losses within a motor, over its mean loss squared
    residual_p05_SPEED … p95       percentiles of `replay_errors` by pool of SPEEDS, for priors trained in closed loop

    If the log has torques, losses with the suffix WITHOUT_TORQUE are added, for new motors whose log has none.
    """
    metrics = loss_metrics(latent_search(model, data, preset).parts(mean), preset, "")
    if preset.objective == "rollout":
        if data.has_torque:
            without = replace(data, has_torque=False)
            metrics |= loss_metrics(latent_search(model, without, preset).parts(mean), preset, WITHOUT_TORQUE)
        errors, velocity = replay_errors(model.motors(mean), log, preset.nominal_conditions)
        pool = _pool(velocity)
        for index, name in enumerate(SPEEDS):
            chosen = errors[pool == index]
            values = np.percentile(chosen if len(chosen) else errors, LEVELS)
            metrics |= dict(zip(_percentiles(name), values.tolist(), strict=True))
    return metrics


def windows_per_block(preset: Preset) -> int:
    """Number of windows in a block."""
    return max(1, round(BLOCK / (preset.window * preset.period)))


def loss_metrics(losses: np.ndarray, preset: Preset, suffix: str) -> dict[str, float]:
    """The ``loss_…`` of `reference_metrics`, from window losses (M, N) in the order of the log."""
    motor, length = losses.mean(axis=1), windows_per_block(preset)
    count = losses.shape[1] // length
    blocks = losses[:, : count * length].reshape(len(losses), count, length).mean(axis=2)
    within = np.mean(blocks.var(axis=1, ddof=1) / blocks.mean(axis=1) ** 2) if count > 1 else 0.0
    std = np.log(motor).std(ddof=1) if len(motor) > 1 else 0.0
    values = (motor.mean(), np.log(motor).mean(), std, len(motor), losses.shape[1] / length, within)
    return {f"loss_{name}{suffix}": float(value) for name, value in zip(_LOSS_METRICS, values, strict=True)}


def _percentiles(pool: str) -> list[str]:
    """Names of a pool's residual metrics, in the order of LEVELS."""
    return [f"residual_p{level:02d}_{pool}" for level in LEVELS]


def _pool(joint_vel: np.ndarray) -> np.ndarray:
    """Index into SPEEDS for velocities [rad/s]."""
    return np.searchsorted(list(SPEEDS.values()), np.abs(joint_vel))


def loss_p_value(metrics: dict[str, float], losses: np.ndarray, count: float, suffix: str = "") -> np.ndarray:
    """(M,) one-sided p-value of the fits: probability that a motor of the prior's fleet has a loss as large [-].

    Mean losses are modelled as log-normal over motors, and the mean over n blocks of one motor's log as log-normal too,
    with the moments of a sum (Fenton & Wilkinson):

        log loss ~ N(m - v/2, s² + v),   v = max(0, log(1 + V/n) - log(1 + V/N))

    where m and s come from logs of N blocks, and V is the variance of a block. Since s is estimated from the training
    motors, the test uses Student's t with motors - 1 degrees of freedom and s²·(1 + 1/motors). ``metrics`` are those of
    the prior with this ``suffix``, ``losses`` (M,) mean window losses of the new motors at their posterior means, and
    ``count`` is n, the number of blocks of their log, which may be a fraction.
    """
    from scipy.stats import t as student_t  # here: it takes half a second to import

    _, m, s, motors, whole, variance = (metrics[f"loss_{name}{suffix}"] for name in _LOSS_METRICS)
    added = max(0.0, math.log1p(variance / count) - math.log1p(variance / whole))
    std = math.sqrt(max(s**2 * (1 + 1 / motors) + added, 1e-12))
    return student_t.sf((np.log(losses) - m + added / 2) / std, max(motors - 1, 1))


def residual_scale(metrics: Mapping[str, float], errors: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
    """(M,) scale of the residuals of M motors: the 90 % quantile of |error| over half the pool's 90 % band.

    ``errors`` [rad] and simulated ``joint_vel`` [rad/s] are (T, M), from `replay_errors`; the speed selects the pool.
    """
    half = [0.5 * (metrics[f"residual_p95_{name}"] - metrics[f"residual_p05_{name}"]) for name in SPEEDS]
    share = np.abs(errors) / np.maximum(np.array(half)[_pool(joint_vel)], _MIN_RESIDUAL)
    return np.clip(np.quantile(share, 0.9, axis=0), *_MISFIT)


def residual_growth(
    model: GreyBox, mean: np.ndarray, classes: JointClasses, log: MotorLog, preset: Preset, metrics: Mapping[str, float]
) -> dict[str, float]:
    """How much residuals grow from the rows that a motor was fitted to, to later rows: metrics GROWTH and GROWTH_STD.

    The training motors, with latents ``mean`` (M, Z), are adapted to the first half of the log as new units of their
    classes. The growth is the median ratio of their `residual_scale` in the second half to that in the first, at least
    1; its logarithm has a standard deviation over the motors, with ASSUMED_GROWTH_STD as three more motors.
    """
    first, rest = train_test_halves(log)
    ratio = np.zeros(0)
    if min(first.duration, rest.duration) > 2.0 * (preset.history + preset.window) * preset.period:
        preset = with_window_that_fits(preset, first)
        data, prior = training_data(first, preset, first.source), classes.mean_and_std(classes.of_motors)
        found = fit_posterior(model, data, preset, metrics["loss_mean"], start=mean, prior=prior)
        motors, nominal = model.motors(found.mean), preset.nominal_conditions
        own, later = (residual_scale(metrics, *replay_errors(motors, part, nominal)) for part in (first, rest))
        ratio = np.log(later / own)[moved(first) & moved(rest)]
    growth = max(0.0, float(np.median(ratio))) if len(ratio) else 0.0
    scatter = float(np.sum((ratio - growth) ** 2)) + 3.0 * ASSUMED_GROWTH_STD**2
    return {GROWTH: math.exp(growth), GROWTH_STD: math.sqrt(scatter / (len(ratio) + 3.0))}


def sample_residual_scale(metrics: Mapping[str, float], misfit: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(M,) sampled factors on the residuals of motors with this ``misfit`` (M,) or (1,) on other rows."""
    std = metrics.get(GROWTH_STD, 0.0)
    return misfit * metrics.get(GROWTH, 1.0) * np.exp(std * rng.standard_normal(len(misfit)))


def sample_residuals(metrics: dict[str, float], rng: np.random.Generator, joint_vel: np.ndarray) -> np.ndarray:
    """Sample residuals [rad] for simulated velocities [rad/s] of any shape, from the percentiles of their pools.

    The quantile function is linear between percentiles, and extrapolated by one interval at both ends.
    """
    pool, quantile, out = _pool(joint_vel), rng.uniform(0, 100, joint_vel.shape), np.zeros(joint_vel.shape)
    for index, name in enumerate(SPEEDS):
        values = np.array([metrics[percentile] for percentile in _percentiles(name)])
        low, high = 2 * values[0] - values[1], 2 * values[-1] - values[-2]
        chosen = pool == index
        out[chosen] = np.interp(quantile[chosen], [0, *LEVELS, 100], [low, *values, high])
    return out


def aggregate_posterior_kl(mean: np.ndarray, log_var: np.ndarray) -> float:
    """KL divergence from N(0, I) of a normal with the moments of the mixture 1/M·Σᵢ N(μᵢ, σᵢ²) [nat].

    With μ = ``mean``, log σ² = ``log_var`` (both (M, Z)), m = avg μ, C = diag(avg σ²) + avg (μ - m)(μ - m)ᵀ it is
    (tr C + |m|² - Z - log det C) / 2.
    """
    center = mean.mean(axis=0)
    covariance = np.diag(np.exp(log_var).mean(axis=0)) + (mean - center).T @ (mean - center) / len(mean)
    log_determinant = np.linalg.slogdet(covariance)[1]
    return float(0.5 * (np.trace(covariance) + center @ center - len(center) - log_determinant))
