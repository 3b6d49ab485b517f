"""Whether new motors lie among those a prior was trained on: their latents, found without the prior's pull.

The loss of a fit tells little: motors of one fleet differ in it by a factor of two. So every new motor is fitted once
more, by `adapt`, under a Gaussian WIDER times as wide as the training motors, in the decoder's own latents (of preset
rollout the logarithms of the constants), downhill from where the prior had it (a search of its own would end in other
valleys), and compared with the training motors, M with mean m and deviation s,

    t = (found - m) / (s·√(1 + 1/M + v)),   P = min(1, Z·min over latents of P(|Student's t with M - 1| > |t|))

where v·s² is the variance that the fit leaves: the prediction interval of one more motor, Bonferroni over Z latents.
Powerful where a log says much of the constant that is odd; a motor whose odd constant its log does not show passes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t

from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.adapt import adapt
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData

WIDER = 3.0
"""Deviation of the fit's Gaussian, in deviations of the training motors."""
_SMALLEST = 1e-9
"""Deviation of a latent in which the training motors do not differ."""


@dataclass(frozen=True)
class Outliers:
    """Of M motors.

    Attributes:
        chance: (M,) P, the chance that one more motor of the fleet lies as far out.
        latent: M names of each motor's oddest latent.
        deviation: (M,) its t.
    """

    chance: np.ndarray
    latent: tuple[str, ...]
    deviation: np.ndarray


def outliers(
    network: LatentNetwork,
    trained: np.ndarray,
    found: np.ndarray,
    data: TrainingData,
    preset: Preset,
    temperature: float,
) -> Outliers:
    """How far from the training motors each motor of ``data`` is.

    Args:
        network: of the prior.
        trained: (M, Z) the training motors' posterior means, M >= 2.
        found: (N, Z) the new motors', from `adapt`.
        data: logs of the new motors.
        preset: the prior's recipe.
        temperature: as for `adapt`.
    """
    known = network.decoder_latents(trained)
    mean, spread = known.mean(axis=0), np.maximum(known.std(axis=0, ddof=1), _SMALLEST)
    wide = Copula(np.eye(len(mean)), mean + WIDER * spread * SCORES[:, None])
    start = (network.decoder_latents(found) - mean) / (WIDER * spread)
    freed = adapt(replace(network, copula=wide), data, preset, temperature, start=start)
    variance = WIDER**2 * np.diagonal(freed.covariance, axis1=1, axis2=2)
    deviation = WIDER * freed.mean / np.sqrt(1.0 + 1.0 / len(known) + variance)
    chances = 2.0 * student_t.sf(np.abs(deviation), len(known) - 1)
    worst = chances.argmin(axis=1)
    rows, names = np.arange(len(worst)), latent_names(network)
    chance = np.minimum(1.0, chances.shape[1] * chances[rows, worst])
    return Outliers(chance, tuple(names[index] for index in worst), deviation[rows, worst])


def latent_names(network: LatentNetwork) -> tuple[str, ...]:
    """Of the decoder's latents: the constants' where each has one of its own."""
    slope = None if network.motor is None else network.motor.slope
    if slope is not None and len(slope) == len(PARAMETERS) and np.array_equal(slope, np.diag(np.diag(slope))):
        return tuple(PARAMETERS)
    return tuple(f"latent {index}" for index in range(network.num_latents))
