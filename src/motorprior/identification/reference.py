"""What a prior knows about its own errors, from the logs it was trained on: the yardstick for new motors."""

from __future__ import annotations

import math
from dataclasses import replace

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
SPEEDS = {"slow": 0.3, "medium": 2.0, "fast": math.inf}
"""Upper bounds of the joint's speed [rad/s] in each pool of residuals: a model errs more where a motor moves."""
_SEGMENTS = 20


def reference_metrics(
    network: LatentNetwork, data: TrainingData, preset: Preset, mean: np.ndarray, log: MotorLog
) -> dict[str, float]:
    """Errors of the training motors at their posterior means.

    Returns:
        ``loss_log_mean`` and ``loss_log_std``: of the logarithm of a motor's mean window loss, over motors;
        ``loss_mean``: mean window loss of all; the same with the ending ``_without_torque`` if the log has torques,
        for new motors whose log has none. For a prior trained in closed loop also ``residual_p05_SPEED`` …
        ``residual_p95_SPEED``: percentiles of joint_pos - simulated joint_pos [rad] when the log's commands and loads
        are replayed from rest, for every pool of SPEEDS of the simulated joint.
    """
    metrics = _loss_metrics(window_losses(network, data, preset, mean).mean(axis=1), "")
    if preset.objective == "rollout":
        if data.has_torque:
            blind = replace(data, has_torque=False)
            metrics |= _loss_metrics(window_losses(network, blind, preset, mean).mean(axis=1), ending(False))
        metrics |= _residual_metrics(LatentActuator(network, mean), log)
    return metrics


def ending(has_torque: bool) -> str:
    """Of the metrics' names for logs with or without torques."""
    return "" if has_torque else "_without_torque"


def _loss_metrics(losses: np.ndarray, name_ending: str) -> dict[str, float]:
    return {
        f"loss_mean{name_ending}": float(losses.mean()),
        f"loss_log_mean{name_ending}": float(np.log(losses).mean()),
        f"loss_log_std{name_ending}": float(np.log(losses).std(ddof=1)) if len(losses) > 1 else 0.0,
    }


def _residual_metrics(motors: LatentActuator, log: MotorLog) -> dict[str, float]:
    residuals, pools = [], []
    for case, truth in trials(log, _SEGMENTS):
        simulated = run(motors, case)
        residuals.append((truth - simulated.joint_pos).ravel())
        pools.append(_pool(simulated.joint_vel).ravel())
    residual, pool, metrics = np.concatenate(residuals), np.concatenate(pools), {}
    for index, name in enumerate(SPEEDS):
        chosen = residual[pool == index]
        values = np.percentile(chosen if len(chosen) else residual, LEVELS)
        metrics |= {f"residual_p{level:02d}_{name}": float(value) for level, value in zip(LEVELS, values, strict=True)}
    return metrics


def _pool(joint_vel: np.ndarray) -> np.ndarray:
    """Index into SPEEDS."""
    return np.searchsorted(list(SPEEDS.values()), np.abs(joint_vel))


def surprise(metrics: dict[str, float], losses: np.ndarray, which: str = "") -> np.ndarray:
    """(M,) probability that a motor of the prior's fleet fits its log as badly: small means unlike anything known.

    One-sided, for log-normal mean window losses; refusing below α has a false-alarm rate of about α.

    Args:
        metrics: of the prior.
        losses: (M,) mean window loss of the new motors at their own posterior means.
        which: `ending` of the metrics to compare with.
    """
    spread = max(metrics[f"loss_log_std{which}"], 1e-6)
    scores = (np.log(losses) - metrics[f"loss_log_mean{which}"]) / spread
    return np.array([0.5 * math.erfc(score / math.sqrt(2.0)) for score in scores])


def draw_residuals(metrics: dict[str, float], rng: np.random.Generator, joint_vel: np.ndarray) -> np.ndarray:
    """Residuals [rad] for simulated speeds [rad/s] of any shape, with the percentiles of their pools.

    Linear between the percentiles, and as far again beyond the last.
    """
    pool, quantile, out = _pool(joint_vel), rng.uniform(0, 100, joint_vel.shape), np.zeros(joint_vel.shape)
    for index, name in enumerate(SPEEDS):
        values = np.array([metrics[f"residual_p{level:02d}_{name}"] for level in LEVELS])
        low, high = 2 * values[0] - values[1], 2 * values[-1] - values[-2]
        chosen = pool == index
        out[chosen] = np.interp(quantile[chosen], [0, *LEVELS, 100], [low, *values, high])
    return out
