"""Gaussian copula from z ~ N(0, I) to the latents of a decoder, for numpy and JAX.

    x = zᵀ·mixing,   latent_k = Q_k(x_k)

mixing gives correlations, x_k is standard normal. Q_k interpolates the latent's ``quantiles``
linearly at SCORES, with linear extrapolation, and gives each latent its distribution over the
training motors.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

# standard normal quantiles of LEVELS
SCORES = np.array([-2.0537, -1.2816, -0.6745, -0.2533, 0.0, 0.2533, 0.6745, 1.2816, 2.0537])
LEVELS = (0.02, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98)
_STEPS = np.diff(SCORES)[:, None]


def decoder_latents(mixing: Any, quantiles: Any, z: Any) -> Any:
    """(n, Z) latents of the decoder for z (n, Z), by numpy or JAX.

    ``mixing`` is (Z, Z), ``quantiles`` are (9, Z), ascending.
    """
    # not @, whose rounding depends on the number of motors
    x = (z[:, :, None] * mixing).sum(axis=1)
    slopes = (quantiles[1:] - quantiles[:-1]) / _STEPS
    beyond = x[:, None, :] - SCORES[1:-1, None]
    bends = (slopes[1:] - slopes[:-1]) * 0.5 * (beyond + abs(beyond))
    return quantiles[0] + slopes[0] * (x - SCORES[0]) + bends.sum(axis=1)


@dataclass(frozen=True)
class Copula:
    """Parameters of `decoder_latents` for Z latents."""

    mixing: np.ndarray  # (Z, Z), invertible
    quantiles: np.ndarray  # (9, Z), ascending

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) latents of the decoder for z (n, Z)."""
        return decoder_latents(self.mixing, self.quantiles, z)


def normal_scores(quantiles: np.ndarray, latents: np.ndarray) -> np.ndarray:
    """(n, Z) standard normal x of latents (n, Z): the inverse of Q."""
    slopes = np.diff(quantiles, axis=0) / _STEPS
    # (n, Z) index of the linear segment
    segment = np.sum(latents[:, None, :] >= quantiles[1:-1], axis=1)
    column = np.arange(latents.shape[1])
    return SCORES[segment] + (latents - quantiles[segment, column]) / slopes[segment, column]
