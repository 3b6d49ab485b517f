"""Least squares with a Gaussian prior for simulations with dry friction: Gauss-Newton with wide central differences.

Minimises c(x) = Σ r(x)² + Σ ((x - mean) / deviation)². Dry friction makes r(x) rough on a small scale, so a derivative
is (r(x + h) - r(x - h)) / 2h with h as wide as the relevant change of x. The covariance of x is that of Laplace,
(JᵀJ + diag(1 / deviation²))⁻¹, if r is weighted by its number of independent samples.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

_STEP_LENGTHS = (1.0, 0.4, 0.15)  # shares of the Gauss-Newton step, tried until one lowers the cost
_TOLERANCE = 3e-3  # relative decrease of the cost below which a search ends

Residuals: TypeAlias = Callable[[np.ndarray], np.ndarray]  # (P,) -> (N,), in units of their standard deviation


@dataclass(frozen=True)
class GaussianPrior:
    """Independent normal prior of P parameters.

    Attributes:
        mean: (P,).
        deviation: (P,) standard deviation, above 0.
        step: (P,) h of the central differences, above 0.
    """

    mean: np.ndarray
    deviation: np.ndarray
    step: np.ndarray

    def cost(self, x: np.ndarray) -> float:
        """Σ ((x - mean) / deviation)²."""
        return float(np.sum(((x - self.mean) / self.deviation) ** 2))


@dataclass(frozen=True)
class Optimum:
    """Result of a search.

    Attributes:
        x: (P,).
        cost: c(x), prior included.
        information: (P, P) JᵀJ of the residuals alone, from the last Jacobian.
    """

    x: np.ndarray
    cost: float
    information: np.ndarray

    def covariance(self, prior: GaussianPrior) -> np.ndarray:
        """(P, P) of x, by Laplace's method."""
        return np.linalg.inv(self.information + np.diag(prior.deviation**-2))


def search(residuals: Residuals, start: np.ndarray, prior: GaussianPrior, iterations: int) -> Optimum:
    """Minimise c(x) from ``start`` (P,) in at most so many iterations."""
    x = np.array(start, dtype=np.float64)
    error = residuals(x)
    cost, slope = float(error @ error) + prior.cost(x), jacobian(residuals, x, prior.step)
    for iteration in range(iterations):
        if iteration:
            slope = jacobian(residuals, x, prior.step)
        lower = _line_search(residuals, x, gauss_newton_step(slope, error, x, prior), prior, cost)
        if lower is None:
            break
        gain, (x, error, cost) = cost - lower[2], lower
        if gain < _TOLERANCE * cost:
            break
    return Optimum(x, cost, slope.T @ slope)


def gauss_newton_step(slope: np.ndarray, error: np.ndarray, x: np.ndarray, prior: GaussianPrior) -> np.ndarray:
    """(P,) step from x to the minimum of c for residuals that are linear with this (N, P) Jacobian."""
    curvature = slope.T @ slope + np.diag(prior.deviation**-2)
    return -np.linalg.solve(curvature, slope.T @ error + (x - prior.mean) / prior.deviation**2)


def jacobian(residuals: Residuals, x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """(N, P) by central differences."""
    columns = [(residuals(x + away) - residuals(x - away)) / (2.0 * away.max()) for away in np.diag(step)]
    return np.stack(columns, axis=1)


def _line_search(
    residuals: Residuals, x: np.ndarray, step: np.ndarray, prior: GaussianPrior, cost: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    for share in _STEP_LENGTHS:
        error = residuals(x + share * step)
        new = float(error @ error) + prior.cost(x + share * step)
        if new < cost:
            return x + share * step, error, new
    return None
