"""Reference statistics of a prior's errors on its training motors, against which new motors are tested."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.stats import t as student_t

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.dynamometer import Response, run
from motorprior.identification.baselines.replay_error import AtGains, trials
from motorprior.identification.latents.latent_fit import window_losses
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData, relative_conditions
from motorprior.logs.motor_log import MotorLog, stated_gains_of

LEVELS = tuple(range(5, 100, 5))
"""Percentiles of the closed-loop residual that are saved [%]."""
SPEEDS = {"slow": 0.3, "medium": 2.0, "fast": math.inf}
"""Upper bound of the joint's speed in each pool of residuals [rad/s]; residuals grow with speed."""
BLOCK = 1.0
"""Duration of the blocks that a log is divided into, each with its own mean loss [s]."""
_SEGMENTS = 20
"""Number of log segments replayed for the residuals, at most."""
_LEAST = {
    "mean": 1e-12, "log_mean": -math.inf, "log_std": 0.0, "motors": 1.0, "pieces": 1e-6, "piece_variance": 0.0,
}  # fmt: skip
"""Smallest valid values of the ``loss_…`` metrics; a missing metric reads as nan and fails the comparison."""


def reference_metrics(
    network: LatentNetwork, data: TrainingData, preset: Preset, mean: np.ndarray, log: MotorLog
) -> dict[str, float]:
    """Errors of the training motors at their posterior means.

    Returns:
        ``loss_log_mean`` and ``loss_log_std``: mean and standard deviation, over the ``loss_motors`` motors, of the
        logarithm of a motor's mean window loss. ``loss_mean``: mean window loss of all motors. ``loss_pieces``: number
        of blocks per motor. ``loss_piece_variance``: variance of the blocks' mean losses within a motor, over the
        motor's mean loss squared. If the log has torques, the same with the ending ``_without_torque``, for new motors
        whose log has none.
        For a prior trained in closed loop also ``residual_p05_SPEED`` … ``residual_p95_SPEED``: percentiles of
        recorded - simulated joint_pos [rad], both read by the same encoder, when the log's commands and loads are
        replayed from where they begin, for every pool of SPEEDS of the simulated joint.
    """
    metrics = loss_metrics(window_losses(network, data, preset, mean), preset, "")
    if preset.objective == "rollout":
        if data.measured.torque:
            blind = replace(data, measured=replace(data.measured, torque=False))
            metrics |= loss_metrics(window_losses(network, blind, preset, mean), preset, ending(False))
        metrics |= _residual_metrics(LatentActuator(network, mean), log, preset)
    return metrics


def ending(has_torque: bool) -> str:
    """Ending of the metrics' names for logs with or without torques."""
    return "" if has_torque else "_without_torque"


def num_blocks(windows: int, preset: Preset) -> float:
    """Number of blocks, not necessarily whole, in a log of so many ``windows``."""
    return windows / _windows_per_block(preset)


def _windows_per_block(preset: Preset) -> int:
    return max(1, round(BLOCK / (preset.window * preset.period)))


def loss_metrics(losses: np.ndarray, preset: Preset, name_ending: str) -> dict[str, float]:
    """The ``loss_…`` of `reference_metrics`, from window losses (M, N) in the order of the log."""
    motor, length = losses.mean(axis=1), _windows_per_block(preset)
    count = losses.shape[1] // length
    blocks = losses[:, : count * length].reshape(len(losses), count, length).mean(axis=2)
    within = np.mean(blocks.var(axis=1, ddof=1) / blocks.mean(axis=1) ** 2) if count > 1 else 0.0
    return {
        f"loss_mean{name_ending}": float(motor.mean()),
        f"loss_log_mean{name_ending}": float(np.log(motor).mean()),
        f"loss_log_std{name_ending}": float(np.log(motor).std(ddof=1)) if len(motor) > 1 else 0.0,
        f"loss_motors{name_ending}": float(len(motor)),
        f"loss_pieces{name_ending}": num_blocks(losses.shape[1], preset),
        f"loss_piece_variance{name_ending}": float(within),
    }


def replayed_segments(log: MotorLog) -> np.ndarray:
    """Places of the segments that `replays` replays: all, or so many that are spread evenly over a log of many."""
    count = len(log.segment_slices())
    return np.linspace(0, count - 1, min(_SEGMENTS, count)).round().astype(int)


def replays(motors: Actuator, log: MotorLog, tell: AtGains) -> list[tuple[np.ndarray, np.ndarray]]:
    """Segments of a log, replayed from where they begin with their commands and loads; one motor per joint of the log.

    Args:
        motors: one per joint.
        log: with known loads; of it `replayed_segments`.
        tell: what the motors are told of a segment.

    Returns:
        Of each segment recorded - simulated angles [rad], both read by the same encoder, and the index into SPEEDS of
        the simulated joint's pool, each (steps, n).
    """
    found, parts = [], list(log.segments())
    for place in replayed_segments(log):
        part = parts[place]
        ((case, truth),) = trials(part)
        simulated = run(tell(motors, part), case)
        found.append((truth - measured_pos(simulated, log), _pool(simulated.joint_vel)))
    return found


def told(motors: Actuator, log: MotorLog, usual: Mapping[str, float]) -> Actuator:
    """Learned motors with the gains that the log states, if they are told any, and under the log's conditions.

    Args:
        motors: any.
        log: or a segment of one.
        usual: conditions of the motors' recipe.
    """
    if not isinstance(motors, LatentActuator):
        return motors
    supply, warmer = relative_conditions(log, usual)
    motors = replace(motors, conditions=motors.conditions._replace(supply=supply, warmer=warmer))
    return replace(motors, gains=stated_gains_of(log)) if motors.network.gain_unit else motors


def _residual_metrics(motors: LatentActuator, log: MotorLog, preset: Preset) -> dict[str, float]:
    parts = replays(motors, log, partial(told, usual=preset.usual_conditions))
    residual, pool = (np.concatenate(each).ravel() for each in zip(*parts, strict=True))
    metrics: dict[str, float] = {}
    for index, name in enumerate(SPEEDS):
        chosen = residual[pool == index]
        values = np.percentile(chosen if len(chosen) else residual, LEVELS)
        metrics |= dict(zip(_percentiles(name), values.tolist(), strict=True))
    return metrics


def measured_pos(simulated: Response, log: MotorLog) -> np.ndarray:
    """(steps, n) simulated angles as the encoders of ``log`` would read them [rad]."""
    return simulated.encoder_pos if log.encoder == "rotor" else simulated.joint_pos


def _percentiles(pool: str) -> list[str]:
    """Names of a pool's residual metrics, in the order of LEVELS."""
    return [f"residual_p{level:02d}_{pool}" for level in LEVELS]


def _pool(joint_vel: np.ndarray) -> np.ndarray:
    """Index into SPEEDS for velocities [rad/s]."""
    return np.searchsorted(list(SPEEDS.values()), np.abs(joint_vel))


def has_reference_metrics(metrics: dict[str, float], closed_loop: bool) -> bool:
    """Whether a prior's metrics suffice for `loss_p_value` and, if trained in closed loop, for `draw_residuals`.

    Args:
        metrics: metrics of the prior.
        closed_loop: whether the prior was trained in closed loop.
    """
    if "loss_mean" not in metrics:
        return False
    endings = [which for which in (ending(True), ending(False)) if f"loss_mean{which}" in metrics]
    return all(
        metrics.get(f"loss_{name}{which}", math.nan) >= least for which in endings for name, least in _LEAST.items()
    ) and (not closed_loop or all(name in metrics for pool in SPEEDS for name in _percentiles(pool)))


def loss_p_value(metrics: dict[str, float], losses: np.ndarray, count: float, name_ending: str = "") -> np.ndarray:
    """(M,) one-sided p-value of the fits: probability that a motor of the prior's fleet has a loss as large [-].

    A test at level α has a false-alarm rate of about α. Mean losses are modelled as log-normal over motors, and the
    mean over n blocks of one motor's log as log-normal too, with the moments of a sum (Fenton & Wilkinson):

        log loss ~ N(m - v/2, s² + v),   v = max(0, log(1 + V/n) - log(1 + V/N))

    where m and s come from logs of N blocks, and V is the variance of a block. Since s is estimated from the training
    motors, the test uses Student's t with motors - 1 degrees of freedom and s²·(1 + 1/motors).

    Args:
        metrics: metrics of the prior.
        losses: (M,) mean window loss of the new motors at their posterior means.
        count: n, number of blocks in the new log; see `num_blocks`.
        name_ending: `ending` of the metrics to compare with.
    """
    m, s, motors, whole, variance = (
        metrics[f"loss_{name}{name_ending}"] for name in ("log_mean", "log_std", "motors", "pieces", "piece_variance")
    )
    added = max(0.0, math.log1p(variance / count) - math.log1p(variance / whole))
    spread = math.sqrt(max(s**2 * (1 + 1 / motors) + added, 1e-12))
    return student_t.sf((np.log(losses) - m + added / 2) / spread, max(motors - 1, 1))


def draw_residuals(metrics: dict[str, float], rng: np.random.Generator, joint_vel: np.ndarray) -> np.ndarray:
    """Draw residuals [rad] for simulated velocities [rad/s] of any shape, from the percentiles of their pools.

    The quantile function is linear between percentiles, and extrapolated by one interval at both ends.
    """
    pool, quantile, out = _pool(joint_vel), rng.uniform(0, 100, joint_vel.shape), np.zeros(joint_vel.shape)
    for index, name in enumerate(SPEEDS):
        values = np.array([metrics[percentile] for percentile in _percentiles(name)])
        low, high = 2 * values[0] - values[1], 2 * values[-1] - values[-2]
        chosen = pool == index
        out[chosen] = np.interp(quantile[chosen], [0, *LEVELS, 100], [low, *values, high])
    return out
