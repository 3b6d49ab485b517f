"""Refinement of a fit to short free runs on longer ones, with the residual network that the motors have.

Long free runs identify constants that short ones confuse, but a search on them ends in poor optima, since an early
error makes later residuals meaningless. So short runs find the neighbourhood, and longer ones refine it. A residual
network is trained with the constants of short runs; they are refined with it once more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.geared_motor_constants import LOG_REACH
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.fleet_fit import fixed_constants, fleet_prior, open_variance, weak_prior
from motorprior.identification.physics.motor_fit import NARROW, WIDE, Fit, GaussianPrior, MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

LONGER = 200  # approximate number of steps of the longer runs
MAX_LOST = 0.2  # largest share of the rows in the recipe's windows that longer windows may leave out
MIN_WINDOWS = 10  # least number of longer windows of a motor
# step of the differences, and most Gauss-Newton steps: wide ones average over ripples, narrow ones find the minimum
TURNS = ((WIDE, 10), (NARROW, 10), (0.01, 10))


def longer_runs(data: TrainingData, preset: Preset, runs: WindowRuns) -> WindowRuns:
    """Free runs of about LONGER steps, or ``runs``, those of the recipe.

    The latter if they are as long, if longer windows leave out more than MAX_LOST of the rows, or if there are fewer
    than MIN_WINDOWS of them.
    """
    lengths = np.array([part.stop - part.start - 1 - preset.history for part in data.parts])
    length = int(np.median(lengths[lengths >= preset.window]))
    window = length // max(1, round(length / LONGER))
    if window <= preset.window:
        return runs
    longer = WindowRuns(data, replace(preset, window=window), beat=runs.beat)
    enough = longer.windows * window >= (1.0 - MAX_LOST) * runs.windows * preset.window
    return longer if enough and longer.windows >= MIN_WINDOWS else runs


def refined(
    network: LatentNetwork, z: np.ndarray, runs: WindowRuns, together: bool, chosen: np.ndarray | None = None
) -> np.ndarray:
    """(M, Z) latents after steps that lower loss and prior on ``runs``, longer than those of the fit (`motor_fit`).

    ``z`` (M, Z) are the fitted latents, ``chosen`` (N,) masks windows. The prior is the fleet's of `fleet_fit` if
    ``together``, estimated once at z; of a motor alone it is weak, around z.
    """
    motor = network.motor
    assert motor is not None
    fit = MotorFit(network, runs, chosen)
    fixed = fixed_constants(motor.terms, runs)
    alone = replace(weak_prior(z.shape[1]), mean=z).fixing(fixed)
    prior = _fleet_prior(fit, z, fixed) if together and len(z) > 1 else alone
    prior, found = replace(prior, mean=np.where(fixed, z, prior.mean)), z
    for reach, steps in TURNS:
        found = fit.polish(found, prior, steps, reach).z
    return np.where(fixed, z, np.clip(found, -LOG_REACH, LOG_REACH))


def _fleet_prior(fit: MotorFit, z: np.ndarray, fixed: np.ndarray) -> GaussianPrior:
    loss = fit.losses(z)
    found = Fit(z, loss, loss)
    first = fleet_prior(found, fit.windows, 0.0).fixing(fixed)
    return fleet_prior(found, fit.windows, open_variance(fit, found, first)).fixing(fixed)
