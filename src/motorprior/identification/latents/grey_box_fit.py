"""The posterior of z for new motors, if they are grey boxes: a search and Gauss-Newton steps on compiled free runs.

The energy is that of `latent_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.motor_fit import WIDE, Fit, GaussianPrior, MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

SEARCH_RADII, SEARCH_DRAWS = (1.0, 1.0, 0.5, 0.25, 0.12), 64  # standard deviations of the random search; samples each
STEPS, TURNS = 8, 20  # Gauss-Newton steps from one start, and the most restarts
IDLE, LEAST_GAIN = 4, 2e-3  # a search ends after so many restarts in a row that lower the energies by a smaller share
REDRAWN = 96  # samples of which each restart is the best: the motor so far, with a random half of z drawn anew
# Standard deviation of a joint from the joint of the same name among the training motors, in those of the prior: an
# assumption, wider than the 13 to 17 % by which frictions of like joints of one robot were found to differ.
SAME_JOINT_STD = 0.3
_NOT_IDENTIFIABLE = 1e-3  # precision, over the prior's, below which a latent is not identifiable from the log
_STREAM = 47


@dataclass(frozen=True)
class LatentPrior:
    """Prior of M motors: z ~ N(mean, std²), (M, Z) and (M,)."""

    mean: np.ndarray
    std: np.ndarray

    @classmethod
    def standard(cls, motors: int, latents: int) -> LatentPrior:
        """N(0, I), of motors of the training fleet."""
        return cls(np.zeros((motors, latents)), np.ones(motors))


@dataclass(frozen=True)
class Posterior:
    """Posterior of M motors with Z latents each."""

    mean: np.ndarray  # (M, Z)
    covariance: np.ndarray  # (M, Z, Z)
    loss: np.ndarray  # (M,) mean loss per window at the mean
    windows: int  # N, windows per motor


def adapt(
    network: LatentNetwork,
    data: TrainingData,
    preset: Preset,
    temperature: float,
    start: np.ndarray | None,
    prior: LatentPrior | None = None,
) -> Posterior:
    """See `latent_fit.adapt`."""
    runs = WindowRuns(data, preset)
    prior = prior or LatentPrior.standard(runs.num_motors, network.num_latents)
    fit, gaussian = MotorFit(network, runs), _gaussian_prior(prior, runs, temperature)
    rng, shape = np.random.default_rng(_STREAM), (runs.num_motors, network.num_latents)
    if start is not None:
        found = fit.polish(start, gaussian, STEPS, WIDE)
        return _posterior(fit, gaussian, fit.polish(found.z, gaussian, STEPS, 0.5 * WIDE), prior, temperature)
    found = fit.polish(fit.search(rng, prior.mean, gaussian, SEARCH_RADII, SEARCH_DRAWS), gaussian, STEPS, WIDE)
    idle = 0
    for _ in range(TURNS):
        drawn = rng.random((shape[0], REDRAWN, shape[1])) < 0.5
        others = prior.mean[:, None] + prior.std[:, None, None] * rng.standard_normal(drawn.shape)
        anew = np.where(drawn, others, found.z[:, None])
        before, found = found, found.better(fit.polish(fit.best_of(anew, gaussian), gaussian, STEPS, WIDE))
        # shares, or a motor that nothing fits would end the search for all others
        gains = 1.0 - found.energy / np.maximum(before.energy, 1e-12)
        idle = 0 if gains.mean() > LEAST_GAIN else idle + 1
        if idle == IDLE:
            break
    found = found.better(fit.polish(found.z, gaussian, STEPS, 0.5 * WIDE))
    return _posterior(fit, gaussian, found, prior, temperature)


def _posterior(fit: MotorFit, gaussian: GaussianPrior, found: Fit, prior: LatentPrior, temperature: float) -> Posterior:
    precision = _precision(fit, found.z, temperature)
    hidden = np.diagonal(precision, axis1=1, axis2=2) * prior.std[:, None] ** 2 < _NOT_IDENTIFIABLE
    z = np.where(hidden, prior.mean, found.z)  # damped steps end before they reach it
    loss = fit.losses(z)
    found = found.better(Fit(z, loss + gaussian.energy(z), loss))
    return Posterior(found.z, inverse_precision(precision, prior.std), found.loss, fit.windows)


def covariance(
    network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray, temperature: float
) -> np.ndarray:
    """See `latent_fit.laplace_covariance`."""
    return inverse_precision(_precision(MotorFit(network, WindowRuns(data, preset)), z, temperature), np.ones(len(z)))


def inverse_precision(precision: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(M, Z, Z) (I/std² + precision)⁻¹, with negative eigenvalues of the precision set to 0."""
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.transpose(0, 2, 1)))
    inverse = 1.0 / (std[:, None] ** -2.0 + np.maximum(values, 0.0))
    return np.einsum("mij,mj,mkj->mik", vectors, inverse, vectors)


def _gaussian_prior(prior: LatentPrior, runs: WindowRuns, temperature: float) -> GaussianPrior:
    precision = temperature / runs.windows / prior.std[:, None] ** 2
    return GaussianPrior(prior.mean, np.broadcast_to(precision, prior.mean.shape))


def _precision(fit: MotorFit, z: np.ndarray, temperature: float) -> np.ndarray:
    return fit.curvatures(z, WIDE) * fit.runs.windows / temperature
