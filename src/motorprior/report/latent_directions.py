"""Principal directions of a latent space: those along which the decoded motors' behaviour varies most."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.bench.behaviour import behaviours

STEP = 0.5
"""Step of a latent for central differences, in standard deviations of the prior."""


@dataclass(frozen=True)
class Directions:
    """Two directions of a space of Z latents.

    Attributes:
        axes: (Z, 2) orthonormal; the largest entries are positive.
        share: (2,) of the variance of all behaviour that z ~ N(0, I) makes, to first order.
    """

    axes: np.ndarray
    share: np.ndarray


def behaviour_directions(network: LatentNetwork) -> Directions:
    """The two principal directions of the bench features (`bench.behaviour`) as functions of z.

    Slopes at z = 0 by central differences of STEP, each feature divided by its standard deviation under z ~ N(0, I),
    which to first order is the norm of its row of slopes. Standardised latents all have variance 1, so that the spread
    of motors along a latent says nothing about its effect.
    """
    nudges = STEP * np.eye(network.num_latents)
    found = behaviours(LatentActuator(network, np.concatenate([nudges, -nudges]))).values
    ahead, behind = np.split(found, 2)
    return principal_directions((ahead - behind).T / (2 * STEP))


def principal_directions(slopes: np.ndarray) -> Directions:
    """Principal directions of slopes (F, Z) of F features, Z >= 2; constant features are left out."""
    spread = np.linalg.norm(slopes, axis=1)
    moved = slopes[spread > 0] / spread[spread > 0, None]
    _, strength, rows = np.linalg.svd(moved, full_matrices=True)
    axes = rows[:2].T
    largest = axes[np.argmax(np.abs(axes), axis=0), np.arange(2)]
    share = np.zeros(2)
    share[: len(strength)] = strength[:2] ** 2 / max(float(np.sum(strength**2)), 1e-300)
    return Directions(axes * np.where(largest < 0.0, -1.0, 1.0), share)


def best_explained(points: np.ndarray, values: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """The ``count`` of the values (M,) that are most nearly linear in points (M, D), by R², best first.

    Values that are the same for every motor are left out.
    """
    basis = np.column_stack([np.ones(len(points)), points])

    def unexplained(name: str) -> float:
        value = values[name]
        fitted = basis @ np.linalg.lstsq(basis, value, rcond=None)[0]
        return float(np.var(value - fitted) / np.var(value))

    varying = [name for name, value in values.items() if np.ptp(value) > 0]
    return {name: values[name] for name in sorted(varying, key=unexplained)[:count]}
