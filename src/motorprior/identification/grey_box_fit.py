"""The posterior of z for new motors, if they are grey boxes: a search and Gauss-Newton steps on compiled free runs.

The energy is that of `latent_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.motor_fit import WIDE, Belief, Fit, MotorFit
from motorprior.identification.presets import Preset
from motorprior.identification.window_runs import WindowRuns
from motorprior.identification.windows import TrainingData

SEARCH_RADII, SEARCH_DRAWS = (1.0, 1.0, 0.5, 0.25, 0.12), 64
"""Standard deviations of the draws in the rounds of the random search, and their number."""
STEPS, TURNS = 8, 5
"""Gauss-Newton steps from one beginning, and how many further beginnings there are."""
REDRAWN = 96
"""Draws of which each further beginning is the best: the motor so far, with a random half of z drawn anew."""
_STREAM = 47


@dataclass(frozen=True)
class Posterior:
    """Posterior of M motors with Z latents each.

    Attributes:
        mean: (M, Z).
        covariance: (M, Z, Z).
        loss: (M,) mean loss per window at the mean.
        windows: N, windows per motor.
    """

    mean: np.ndarray
    covariance: np.ndarray
    loss: np.ndarray
    windows: int


def adapt(
    network: LatentNetwork, data: TrainingData, preset: Preset, temperature: float, start: np.ndarray | None
) -> Posterior:
    """See `latent_fit.adapt`."""
    runs = WindowRuns(data, preset)
    fit, belief = MotorFit(network, runs), _standard_normal(network, runs, temperature)
    rng, shape = np.random.default_rng(_STREAM), (runs.num_motors, network.num_latents)
    if start is not None:
        found = fit.polish(start, belief, STEPS, WIDE)
        return _posterior(fit, fit.polish(found.z, belief, STEPS, 0.5 * WIDE), temperature)
    found = fit.polish(fit.search(rng, np.zeros(shape), belief, SEARCH_RADII, SEARCH_DRAWS), belief, STEPS, WIDE)
    for _ in range(TURNS):
        anew = np.where(
            rng.random((shape[0], REDRAWN, shape[1])) < 0.5,
            rng.standard_normal((shape[0], REDRAWN, shape[1])),
            found.z[:, None],
        )
        found = found.better(fit.polish(fit.best_of(anew, belief), belief, STEPS, WIDE))
    return _posterior(fit, found.better(fit.polish(found.z, belief, STEPS, 0.5 * WIDE)), temperature)


def _posterior(fit: MotorFit, found: Fit, temperature: float) -> Posterior:
    return Posterior(found.z, _covariance(fit, found.z, temperature), found.loss, fit.windows)


def covariance(
    network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray, temperature: float
) -> np.ndarray:
    """See `latent_fit.laplace_covariance`."""
    return _covariance(MotorFit(network, WindowRuns(data, preset)), z, temperature)


def inverse_precision(precision: np.ndarray) -> np.ndarray:
    """(M, Z, Z) (I + precision)⁻¹, with negative eigenvalues of the precision set to 0."""
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.transpose(0, 2, 1)))
    inverse = 1.0 / (1.0 + np.maximum(values, 0.0))
    return np.einsum("mij,mj,mkj->mik", vectors, inverse, vectors)


def _standard_normal(network: LatentNetwork, runs: WindowRuns, temperature: float) -> Belief:
    size = network.num_latents
    return Belief(np.zeros(size), np.full(size, temperature / runs.windows))


def _covariance(fit: MotorFit, z: np.ndarray, temperature: float) -> np.ndarray:
    return inverse_precision(fit.curvatures(z, WIDE) * fit.runs.windows / temperature)
