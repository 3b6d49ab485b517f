"""The posterior of z for new motors, from seconds of log; the network's weights stay fixed.

    minimise  U(z) = N·loss(z)/T + ½|z - m|²/d²,     covariance = (I/d² + N·G(z)/T)⁻¹

loss is the prior's training objective, averaged over N windows that do not overlap, and G its Gauss-Newton matrix. The
temperature T is the mean loss of the training motors, so that a window fitted as well as theirs counts as one
observation (a generalised posterior with a Laplace approximation). The prior has m = 0 and d = 1; for a joint with the
name of a training motor, m is that motor's mean and d SAME_JOINT_STD. U of a grey box is minimised by a random search
and Gauss-Newton steps on compiled free runs, that of a network without physics by `network_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latents.network_fit import NetworkFit
from motorprior.identification.physics.motor_fit import WIDE, Fit, GaussianPrior, MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

ADAM_STEPS = 300  # of a network without physics
SEARCH_RADII, SEARCH_DRAWS = (1.0, 1.0, 0.5, 0.25, 0.12), 64  # standard deviations of the random search; samples each
STEPS, MAX_RESTARTS = 8, 20  # Gauss-Newton steps from one start
PATIENCE, MIN_GAIN = 4, 2e-3  # the search ends after PATIENCE restarts in a row with relative gains of at most MIN_GAIN
RESAMPLED = 96  # candidates per restart: the best z so far, with a random half of it resampled
# assumed standard deviation from the training motor of the same joint name, in prior standard deviations; frictions of
# equal joints of one robot differ by 13 to 17 %
SAME_JOINT_STD = 0.3
_NOT_IDENTIFIABLE = 1e-3  # precision, over the prior's, below which a latent is not identifiable from the log
_STREAM = 47


@dataclass(frozen=True)
class LatentPrior:
    """Prior of M motors: z ~ N(mean, std²), (M, Z) and (M,)."""

    mean: np.ndarray
    std: np.ndarray


@dataclass(frozen=True)
class Posterior:
    """Posterior of M motors with Z latents each."""

    mean: np.ndarray  # (M, Z)
    covariance: np.ndarray  # (M, Z, Z)
    loss: np.ndarray  # (M,) mean loss per window at the mean
    windows: int  # N, windows per motor


def fit_posterior(
    network: LatentNetwork,
    data: TrainingData,
    preset: Preset,
    temperature: float,
    steps: int = ADAM_STEPS,
    start: np.ndarray | None = None,
    prior: LatentPrior | None = None,
) -> Posterior:
    """Posterior of every motor in ``data``; its scales must be those of the network.

    Args:
        network: of the prior.
        data: logs of the new motors.
        preset: the prior's recipe.
        temperature: T, mean window loss of the prior's training motors (`reference.reference_metrics`).
        steps: of Adam, for a network without physics.
        start: (M, Z) initial latents; found by a random search if not given.
        prior: of grey boxes; N(0, I) if not given.
    """
    if network.motor is None:
        fit = NetworkFit(network, data, preset, temperature)
        mode = fit.mode(steps, start)
        covariance = inverse_precision(fit.precision(mode), np.ones(len(mode)))
        return Posterior(mode.astype(np.float64), covariance, fit.losses(mode), fit.count)
    runs = WindowRuns(data, preset)
    shape = (runs.num_motors, network.num_latents)
    prior = prior or LatentPrior(np.zeros(shape), np.ones(shape[0]))
    precision = temperature / runs.windows / prior.std[:, None] ** 2
    gaussian = GaussianPrior(prior.mean, np.broadcast_to(precision, prior.mean.shape))
    fit = MotorFit(network, runs)
    found = _search(fit, gaussian, prior) if start is None else fit.polish(start, gaussian, STEPS, WIDE)
    found = found.better(fit.polish(found.z, gaussian, STEPS, 0.5 * WIDE))
    likelihood = _precision(fit, found.z, temperature)
    hidden = np.diagonal(likelihood, axis1=1, axis2=2) * prior.std[:, None] ** 2 < _NOT_IDENTIFIABLE
    z = np.where(hidden, prior.mean, found.z)  # damped steps end before they reach it
    loss = fit.losses(z)
    found = found.better(Fit(z, loss + gaussian.energy(z), loss))
    return Posterior(found.z, inverse_precision(likelihood, prior.std), found.loss, fit.windows)


def _search(fit: MotorFit, gaussian: GaussianPrior, prior: LatentPrior) -> Fit:
    rng, shape = np.random.default_rng(_STREAM), prior.mean.shape
    found = fit.polish(fit.search(rng, prior.mean, gaussian, SEARCH_RADII, SEARCH_DRAWS), gaussian, STEPS, WIDE)
    idle = 0
    for _ in range(MAX_RESTARTS):
        redrawn = rng.random((shape[0], RESAMPLED, shape[1])) < 0.5
        others = prior.mean[:, None] + prior.std[:, None, None] * rng.standard_normal(redrawn.shape)
        starts = np.where(redrawn, others, found.z[:, None])
        before, found = found, found.better(fit.polish(fit.best_of(starts, gaussian), gaussian, STEPS, WIDE))
        # relative gains: otherwise a motor that no constants fit would end the search for all others
        gains = 1.0 - found.energy / np.maximum(before.energy, 1e-12)
        idle = 0 if gains.mean() > MIN_GAIN else idle + 1
        if idle == PATIENCE:
            break
    return found


def laplace_covariance(
    network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray, temperature: float
) -> np.ndarray:
    """(M, Z, Z) Laplace covariance at known modes z (M, Z); formula in the module docstring."""
    if network.motor is None:
        precision = NetworkFit(network, data, preset, temperature).precision(z)
    else:
        precision = _precision(MotorFit(network, WindowRuns(data, preset)), z, temperature)
    return inverse_precision(precision, np.ones(len(z)))


def window_losses(network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray) -> np.ndarray:
    """(M, N) loss of each of the non-overlapping windows, with the motors at latents z (M, Z)."""
    if network.motor is None:
        return NetworkFit(network, data, preset, 1.0).window_losses(z)
    return MotorFit(network, WindowRuns(data, preset)).window_losses(z)


def inverse_precision(precision: np.ndarray, std: np.ndarray) -> np.ndarray:
    """(M, Z, Z) (I/std² + precision)⁻¹, with negative eigenvalues of the precision set to 0."""
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.transpose(0, 2, 1)))
    inverse = 1.0 / (std[:, None] ** -2.0 + np.maximum(values, 0.0))
    return np.einsum("mij,mj,mkj->mik", vectors, inverse, vectors)


def _precision(fit: MotorFit, z: np.ndarray, temperature: float) -> np.ndarray:
    return fit.curvatures(z, WIDE) * fit.runs.windows / temperature
