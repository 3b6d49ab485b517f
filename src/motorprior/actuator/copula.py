"""From z ~ N(0, I) to latents of a decoder: a Gaussian copula, shared by numpy and JAX.

    x = zᵀ·mixing,   latent_k = Q_k(x_k)

mixing carries the correlations, x_k is standard normal, and Q_k, which runs straight through the latent's ``quantiles``
at SCORES and on at the ends, gives each latent the distribution it has among the training motors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

# Standard normal quantiles of LEVELS
SCORES = np.array([-2.0537, -1.2816, -0.6745, -0.2533, 0.0, 0.2533, 0.6745, 1.2816, 2.0537])
LEVELS = (0.02, 0.1, 0.25, 0.4, 0.5, 0.6, 0.75, 0.9, 0.98)
_STEPS = np.diff(SCORES)[:, None]


def decoder_latents(mixing: Any, quantiles: Any, z: Any) -> Any:
    """(n, Z) latents of the decoder for z (n, Z), by numpy or JAX; mixing (Z, Z), quantiles (9, Z) ascending."""
    x = (z[:, :, None] * mixing).sum(axis=1)  # not @, whose rounding depends on the number of motors
    slopes = (quantiles[1:] - quantiles[:-1]) / _STEPS
    beyond = x[:, None, :] - SCORES[1:-1, None]
    bends = (slopes[1:] - slopes[:-1]) * 0.5 * (beyond + abs(beyond))
    return quantiles[0] + slopes[0] * (x - SCORES[0]) + bends.sum(axis=1)


@dataclass(frozen=True)
class Copula:
    """Numbers of `decoder_latents`; Z latents."""

    mixing: np.ndarray  # (Z, Z), invertible
    quantiles: np.ndarray  # (9, Z), ascending

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) latents of the decoder for z (n, Z)."""
        return decoder_latents(self.mixing, self.quantiles, z)


def scores(quantiles: np.ndarray, latents: np.ndarray) -> np.ndarray:
    """(n, Z) standard normal x of latents (n, Z): the inverse of Q."""
    slopes = np.diff(quantiles, axis=0) / _STEPS
    part = np.sum(latents[:, None, :] >= quantiles[1:-1], axis=1)  # (n, Z) index of the straight piece
    column = np.arange(latents.shape[1])
    return SCORES[part] + (latents - quantiles[part, column]) / slopes[part, column]
