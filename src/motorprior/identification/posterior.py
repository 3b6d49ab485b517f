"""The posteriors of the training motors in standardised latents."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.latent_fit import laplace_covariance, window_losses
from motorprior.identification.presets import Preset
from motorprior.identification.standardise import standardised
from motorprior.identification.windows import TrainingData


def standard_posterior(
    network: LatentNetwork, data: TrainingData, preset: Preset, mean: np.ndarray
) -> tuple[LatentNetwork, np.ndarray, np.ndarray]:
    """Network, means and log-variances (M, Z) in latents in which the training motors are distributed as N(0, I).

    The variances are the diagonal of the Laplace approximation of `adapt`, with the motors' mean loss as temperature.

    Args:
        network: trained network.
        data: the motors' logs.
        preset: recipe of the training.
        mean: (M, Z) latents of the motors after training.
    """
    network, mean = standardised(network, mean)
    if mean.size == 0:
        return network, mean, np.zeros_like(mean)
    temperature = float(window_losses(network, data, preset, mean).mean())
    covariance = laplace_covariance(network, data, preset, mean, temperature)
    return network, mean, np.log(np.diagonal(covariance, axis1=1, axis2=2))
