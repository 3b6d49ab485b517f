"""What a prior knows about its own errors, from the logs it was trained on: the yardstick for new motors."""

from __future__ import annotations

import math

import numpy as np

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.dynamometer import run
from motorprior.identification.adapt import window_losses
from motorprior.identification.baselines import trials
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData
from motorprior.logs.motor_log import MotorLog

LEVELS = tuple(range(5, 100, 5))
"""Percentiles of the closed-loop residual that are kept."""
_SEGMENTS = 20


def reference_metrics(
    network: LatentNetwork, data: TrainingData, preset: Preset, mean: np.ndarray, log: MotorLog
) -> dict[str, float]:
    """Errors of the training motors at their posterior means.

    Returns:
        ``loss_log_mean`` and ``loss_log_std``: of the logarithm of a motor's mean window loss, over motors;
        ``loss_mean``: mean window loss of all; for a prior trained in closed loop also ``residual_p05`` …
        ``residual_p95``: percentiles of joint_pos - simulated joint_pos [rad] when the log's commands and loads are
        replayed from rest.
    """
    losses = window_losses(network, data, preset, mean).mean(axis=1)
    metrics = {
        "loss_mean": float(losses.mean()),
        "loss_log_mean": float(np.log(losses).mean()),
        "loss_log_std": float(np.log(losses).std(ddof=1)) if len(losses) > 1 else 0.0,
    }
    if preset.objective == "rollout":
        motors = LatentActuator(network, mean)
        residual = [truth - run(motors, case).joint_pos for case, truth in trials(log, _SEGMENTS)]
        values = np.percentile(np.concatenate(residual), LEVELS)
        metrics |= {f"residual_p{level:02d}": float(value) for level, value in zip(LEVELS, values, strict=True)}
    return metrics


def surprise(metrics: dict[str, float], losses: np.ndarray) -> np.ndarray:
    """(M,) probability that a motor of the prior's fleet fits its log as badly: small means unlike anything known.

    One-sided, for log-normal mean window losses; refusing below α has a false-alarm rate of about α.

    Args:
        metrics: of the prior.
        losses: (M,) mean window loss of the new motors at their own posterior means.
    """
    spread = max(metrics["loss_log_std"], 1e-6)
    scores = (np.log(losses) - metrics["loss_log_mean"]) / spread
    return np.array([0.5 * math.erfc(score / math.sqrt(2.0)) for score in scores])


def draw_residuals(metrics: dict[str, float], rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Residuals [rad] with the prior's percentiles, linear between them and as far again beyond the last."""
    values = np.array([metrics[f"residual_p{level:02d}"] for level in LEVELS])
    low, high = 2 * values[0] - values[1], 2 * values[-1] - values[-2]
    return np.interp(rng.uniform(0, 100, shape), [0, *LEVELS, 100], [low, *values, high])
