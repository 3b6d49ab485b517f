"""Errors of models on a held-out log: free runs of a second and of whole segments, from commands and loads alone.

Each free run starts from the recorded joint and from the hidden state of a simulation that followed the recording until
then (`window_runs`). A run of a whole segment does so once, after the warm-up at the beginning of the segment. Errors
are simulated minus recorded angles, the latter smoothed where readings are noisy (`smoothing`); no mean is removed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.ideal_pd import GainScaledPd
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification.baselines.response_models import ResponseMotors
from motorprior.identification.evaluation.coverage import DRAWS, LEVELS, band, latent_samples
from motorprior.identification.evaluation.reference import sample_residuals
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.identification.physics.window_runs import POSITION_SCALE, VELOCITY_SCALE, WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import POS, SECONDS, TARGET, VEL, training_data
from motorprior.logs.motor_log import MotorLog
from motorprior.signals import rms

FREE_RUN = 1.0  # length of a free run [s]
LogModel: TypeAlias = Actuator | GainScaledPd | ResponseMotors  # motors on the log's loads, or responses without loads
_STREAM = 53


def free_runs(log: MotorLog, preset: Preset, where: str) -> WindowRuns:
    """The log as free runs of FREE_RUN, with the warm-up of a recipe; raises `LogError` (see `training_data`)."""
    preset = replace(preset, objective="rollout", window=round(FREE_RUN / preset.period))
    return WindowRuns(training_data(log, preset, where), preset)


def whole_runs(log: MotorLog, preset: Preset, where: str) -> list[WindowRuns]:
    """Every segment of the log that is longer than the warm-up as one free run; raises `LogError`."""
    preset = replace(preset, objective="rollout", window=1)
    data = training_data(log, preset, where)
    windows = [(part, part.stop - part.start - 1 - preset.history) for part in data.parts]
    return [
        WindowRuns(replace(data, parts=(part,)), replace(preset, window=window))
        for part, window in windows
        if window > 0
    ]


def free_run_errors(runs: Sequence[WindowRuns], models: Mapping[str, LogModel]) -> dict[str, np.ndarray]:
    """(M,) root mean square angle error [rad] of each model of the log's M motors, over all samples of its runs."""
    found = {}
    for name, model in models.items():
        parts = [angle_errors(one, model).reshape(one.num_motors, -1) for one in runs]
        found[name] = rms(np.concatenate(parts, axis=1, dtype=np.float64), axis=1)
    return found


def within_a_turn(errors: np.ndarray | float) -> np.ndarray:
    """The errors [rad], at most one turn; NaN, the error of a diverged simulation, becomes one turn."""
    return np.minimum(np.nan_to_num(errors, nan=math.tau), math.tau)


def angle_errors(runs: WindowRuns, model: LogModel) -> np.ndarray:
    """(M, N, W) simulated minus recorded angles [rad] of a model of the log's M motors."""
    return model.errors(runs) if isinstance(model, ResponseMotors) else POSITION_SCALE * runs.errors(model)[:, :, 0]


def zero_shot(prior: MotorPrior, num_motors: int) -> Posterior:
    """The distribution of motors without a log of theirs: z ~ N(0, I)."""
    latents = prior.network.num_latents
    covariance = np.tile(np.eye(latents), (num_motors, 1, 1))
    return Posterior(np.zeros((num_motors, latents)), covariance, np.zeros(num_motors), 0)


def log_coverage(prior: MotorPrior, posterior: Posterior, runs: Sequence[WindowRuns]) -> dict[int, float]:
    """Share of the recorded angles inside the central bands of posterior samples, by level of the band [%]."""
    rng = np.random.default_rng(_STREAM)
    inside = {level: [] for level in LEVELS}
    for one in runs:
        errors = _sampled_errors(prior, posterior, one, rng)
        for level in LEVELS:
            low, high = band(errors, level)
            inside[level].append(((low <= 0.0) & (high >= 0.0)).ravel())
    return {level: float(np.mean(np.concatenate(parts))) for level, parts in inside.items()}


def _sampled_errors(prior: MotorPrior, posterior: Posterior, runs: WindowRuns, rng: np.random.Generator) -> np.ndarray:
    """(DRAWS, M, N, W) errors [rad] of samples of the posterior, each with residuals of its prior."""
    recorded, errors = runs.recorded(VEL), []
    for z in latent_samples(posterior, rng, DRAWS):
        found = runs.errors(LatentActuator(prior.network, z))
        velocity = recorded + VELOCITY_SCALE * found[:, :, 1]
        errors.append(POSITION_SCALE * found[:, :, 0] + sample_residuals(prior.metrics, rng, velocity))
    return np.stack(errors)


@dataclass(frozen=True)
class LogTraces:
    """The longest segment of a log, recorded and simulated with a model of its M motors, and bands of samples."""

    time: np.ndarray  # (T,) since the log began [s]
    position_target: np.ndarray  # (T, M) [rad]
    joint_pos: np.ndarray  # (T, M) recorded [rad]
    model: np.ndarray  # (T, M) simulated [rad]
    bands: dict[int, tuple[np.ndarray, np.ndarray]]  # level [%] -> lower and upper edge, each (T, M) [rad]


def log_traces(prior: MotorPrior, posterior: Posterior, runs: Sequence[WindowRuns]) -> LogTraces:
    """Free runs of the posterior's mean and of its samples over the longest of ``runs``."""
    longest = max(runs, key=lambda one: one.preset.window)
    time, target, recorded = (longest.recorded(channel)[:, 0].T for channel in (SECONDS, TARGET, POS))
    model = recorded + angle_errors(longest, LatentActuator(prior.network, posterior.mean))[:, 0].T
    errors = _sampled_errors(prior, posterior, longest, np.random.default_rng(_STREAM))[:, :, 0]
    edges = {level: band(errors, level) for level in LEVELS}
    bands = {level: (recorded + low.T, recorded + high.T) for level, (low, high) in edges.items()}
    return LogTraces(time[:, 0], target, recorded, model, bands)
