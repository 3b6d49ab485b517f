"""Latents in which the training motors together are N(0, I), so that a draw of N(0, I) is a motor like them.

The KL term pulls the motors' posteriors towards N(0, I), not their sum onto it: directions that the logs say little
about stay narrower, and draws would be wider than the motors. z acts through linear maps only, so z = m + L·z' with

    m = mean_i μ_i,   L·Lᵀ = cov_i μ_i + mean_i diag(σ_i²)

is absorbed into the decoder: motors stay what they are, but for constants that the decoder clips (LOG_REACH), about the
new centre from then on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.distribution import aggregate_posterior_summary

MOTORS_PER_LATENT = 2
"""With fewer motors the covariance would be mostly chance, and the latents stay as they are."""


def standardised(
    network: LatentNetwork, mean: np.ndarray, log_var: np.ndarray
) -> tuple[LatentNetwork, np.ndarray, np.ndarray]:
    """The same motors in latents whose aggregate posterior has mean 0 and covariance I.

    Args:
        network: trained.
        mean: (M, Z) posterior means.
        log_var: (M, Z) logarithms of their variances.

    Returns:
        The network, means and log-variances in the new latents; as given if there are none, or too few motors. The
        posteriors stay diagonal: only their variances along the new latents are kept.
    """
    motors, latents = mean.shape
    if latents == 0 or motors < MOTORS_PER_LATENT * latents:
        return network, mean, log_var
    together = aggregate_posterior_summary(mean, log_var)
    factor = np.linalg.cholesky(together.covariance)
    inverse = np.linalg.inv(factor)
    return (
        _absorb(network, together.mean, factor),
        (mean - together.mean) @ inverse.T,
        np.log(np.exp(log_var) @ (inverse**2).T),
    )


def _absorb(network: LatentNetwork, center: np.ndarray, factor: np.ndarray) -> LatentNetwork:
    """The network as a function of z' where z = center + factor·z'."""
    motor = network.motor
    if motor is not None:
        motor = GearedMotor(motor.center + center @ motor.slope, factor.T @ motor.slope)
    return replace(
        network,
        b1=network.b1 + center @ network.v1,
        v1=factor.T @ network.v1,
        log_armature=np.asarray(network.log_armature + center @ network.armature_slope),
        armature_slope=factor.T @ network.armature_slope,
        motor=motor,
    )
