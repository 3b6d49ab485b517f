"""The posterior of z for new motors, if they are grey boxes: a search and Gauss-Newton steps on compiled free runs.

The energy is that of `latent_fit`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.motor_fit import WIDE, Belief, Fit, MotorFit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData

# Standard deviations of the draws in the rounds of the random search, and their number
SEARCH_RADII, SEARCH_DRAWS = (1.0, 1.0, 0.5, 0.25, 0.12), 64
STEPS, TURNS = 8, 20  # Gauss-Newton steps from one beginning, and the most restarts
# A search ends after so many restarts in a row of which each lowers the motors' energies by less, mean share
IDLE, LEAST_GAIN = 4, 2e-3
_LEAST_ENERGY = 1e-12  # An energy below counts as this
REDRAWN = 96  # Draws of which each further beginning is the best: the motor so far, with a random half of z drawn anew
# How far a joint is believed to be from the joint of the same name that a prior was trained on, in deviations of
# the prior: an assumption, wide of the 13 to 17 % by which frictions of like joints of one robot were found to
# differ
OF_THE_SAME_NAME = 0.3
_UNFELT = 1e-3  # Precision, of the belief's, below which a log says nothing of a latent
_STREAM = 47


@dataclass(frozen=True)
class Expected:
    """What is believed of M motors before their log: z ~ N(mean, deviation²), (M, Z) and (M,)."""

    mean: np.ndarray
    deviation: np.ndarray

    @classmethod
    def nothing(cls, motors: int, latents: int) -> Expected:
        """Motors of the prior's fleet: N(0, I)."""
        return cls(np.zeros((motors, latents)), np.ones(motors))


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
    network: LatentNetwork,
    data: TrainingData,
    preset: Preset,
    temperature: float,
    start: np.ndarray | None,
    expected: Expected | None = None,
) -> Posterior:
    """See `latent_fit.adapt`."""
    runs = WindowRuns(data, preset)
    known = expected or Expected.nothing(runs.num_motors, network.num_latents)
    fit, belief = MotorFit(network, runs), _belief(known, runs, temperature)
    rng, shape = np.random.default_rng(_STREAM), (runs.num_motors, network.num_latents)
    if start is not None:
        found = fit.polish(start, belief, STEPS, WIDE)
        return _posterior(fit, belief, fit.polish(found.z, belief, STEPS, 0.5 * WIDE), known, temperature)
    found = fit.polish(fit.search(rng, known.mean, belief, SEARCH_RADII, SEARCH_DRAWS), belief, STEPS, WIDE)
    idle = 0
    for _ in range(TURNS):
        drawn = rng.random((shape[0], REDRAWN, shape[1])) < 0.5
        others = known.mean[:, None] + known.deviation[:, None, None] * rng.standard_normal(drawn.shape)
        anew = np.where(drawn, others, found.z[:, None])
        before, found = found, found.better(fit.polish(fit.best_of(anew, belief), belief, STEPS, WIDE))
        # shares, or a motor that nothing fits would end the search for all others
        gains = 1.0 - found.energy / np.maximum(before.energy, _LEAST_ENERGY)
        idle = 0 if gains.mean() > LEAST_GAIN else idle + 1
        if idle == IDLE:
            break
    found = found.better(fit.polish(found.z, belief, STEPS, 0.5 * WIDE))
    return _posterior(fit, belief, found, known, temperature)


def _posterior(fit: MotorFit, belief: Belief, found: Fit, known: Expected, temperature: float) -> Posterior:
    """Of motors found, whose latents that their log says nothing of are as believed: damped steps end on the way."""
    precision = _precision(fit, found.z, temperature)
    unfelt = np.diagonal(precision, axis1=1, axis2=2) * known.deviation[:, None] ** 2 < _UNFELT
    believed = np.where(unfelt, known.mean, found.z)
    loss = fit.losses(believed)
    found = found.better(Fit(believed, loss + belief.energy(believed), loss))
    return Posterior(found.z, inverse_precision(precision, known.deviation), found.loss, fit.windows)


def covariance(
    network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray, temperature: float
) -> np.ndarray:
    """See `latent_fit.laplace_covariance`."""
    return inverse_precision(_precision(MotorFit(network, WindowRuns(data, preset)), z, temperature), np.ones(len(z)))


def inverse_precision(precision: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """(M, Z, Z) (I/deviation² + precision)⁻¹, with negative eigenvalues of the precision set to 0."""
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.transpose(0, 2, 1)))
    inverse = 1.0 / (deviation[:, None] ** -2.0 + np.maximum(values, 0.0))
    return np.einsum("mij,mj,mkj->mik", vectors, inverse, vectors)


def _belief(known: Expected, runs: WindowRuns, temperature: float) -> Belief:
    precision = temperature / runs.windows / known.deviation[:, None] ** 2
    return Belief(known.mean, np.broadcast_to(precision, known.mean.shape))


def _precision(fit: MotorFit, z: np.ndarray, temperature: float) -> np.ndarray:
    """(M, Z, Z) N·G(z)/T, what the log says."""
    return fit.curvatures(z, WIDE) * fit.runs.windows / temperature
