"""How far models are from a log that nothing was fitted to: free runs of a second, command in, motion out.

A log takes the place of physical motors where none are known. Its first half tells of its motors (`known_half`), the
second half is judged. Each free run begins with the recorded joint and with the hidden state of a simulation that
followed the recording until then (`window_runs`). Errors are simulated minus recorded angles, the latter smoothed where
readings are noisy (`smoothing`); no mean is removed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification.coverage import DRAWS, LEVELS, band, latent_draws
from motorprior.identification.latent_fit import Posterior
from motorprior.identification.loss import POSITION_SCALE, VELOCITY_SCALE
from motorprior.identification.presets import Preset
from motorprior.identification.reference import draw_residuals
from motorprior.identification.window_runs import WindowRuns
from motorprior.identification.windows import VEL, training_data
from motorprior.logs.motor_log import MotorLog

FREE_RUN = 1.0
"""Length of a free run [s]."""
_STREAM = 53


def known_half(log: MotorLog) -> tuple[MotorLog, MotorLog]:
    """A log in two: cut where the segment begins that is nearest to its middle row, or there if it has only one."""
    starts = [part.start for part in log.segment_slices()[1:]]
    cut = min(starts, key=lambda row: abs(row - log.num_rows / 2), default=log.num_rows // 2)
    return log.rows(slice(0, cut)), log.rows(slice(cut, log.num_rows))


def free_runs(log: MotorLog, preset: Preset, where: str) -> WindowRuns:
    """The log as free runs of FREE_RUN, with the warm-up of a recipe.

    Raises:
        LogError: it lacks a channel, has another sample period, or no segment is long enough.
    """
    preset = replace(preset, objective="rollout", window=round(FREE_RUN / preset.period))
    return WindowRuns(training_data(log, preset, where), preset)


def free_run_errors(runs: WindowRuns, models: Mapping[str, Actuator]) -> dict[str, np.ndarray]:
    """(M,) root mean square angle error [rad] of each model of the log's M motors."""
    return {
        name: POSITION_SCALE * np.sqrt(np.mean(np.square(runs.errors(model)[:, :, 0], dtype=np.float64), axis=(1, 2)))
        for name, model in models.items()
    }


def log_coverage(prior: MotorPrior, posterior: Posterior, runs: WindowRuns) -> dict[int, float]:
    """Share of the recorded angles inside the central bands of draws from the posterior, by the band's level [%]."""
    rng, errors = np.random.default_rng(_STREAM), []
    recorded = runs.recorded(VEL)
    for z in latent_draws(posterior, rng, DRAWS):
        found = runs.errors(LatentActuator(prior.network, z))
        velocity = recorded + VELOCITY_SCALE * found[:, :, 1]
        errors.append(POSITION_SCALE * found[:, :, 0] + draw_residuals(prior.metrics, rng, velocity))
    bands = {level: band(np.stack(errors), level) for level in LEVELS}
    return {level: float(np.mean((low <= 0.0) & (high >= 0.0))) for level, (low, high) in bands.items()}
