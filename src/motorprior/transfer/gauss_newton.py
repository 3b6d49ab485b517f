"""Least squares with a Gaussian belief, for simulations that stick: Gauss-Newton with wide central differences.

Minimises c(x) = Σ r(x)² + Σ ((x - mean) / deviation)². Dry friction makes r(x) rough on a small scale, so a derivative
is (r(x + h) - r(x - h)) / 2h with a step h as wide as the change of x that matters. About the optimum c is a parabola
and (JᵀJ + diag(1 / deviation²))⁻¹ the covariance of x (Laplace), if r counts its independent readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

_SHARES = (1.0, 0.4, 0.15)
"""Of the Gauss-Newton step that are tried, until one lowers the cost."""
_ENOUGH = 3e-3
"""A search ends when an iteration lowers the cost by less than this share of it."""


@dataclass(frozen=True)
class Belief:
    """What is believed of P parameters beforehand, and how far apart differences are taken.

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
    """Where a search ended.

    Attributes:
        x: (P,).
        cost: c(x), belief included.
        information: (P, P) JᵀJ of the residuals alone, from the last slope that was taken.
    """

    x: np.ndarray
    cost: float
    information: np.ndarray

    def covariance(self, belief: Belief) -> np.ndarray:
        """(P, P) of x, by Laplace's method."""
        return np.linalg.inv(self.information + np.diag(belief.deviation**-2))


Residuals: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""(P,) -> (N,), each in units of its standard deviation."""


def search(residuals: Residuals, start: np.ndarray, belief: Belief, iterations: int) -> Optimum:
    """Descend from ``start`` (P,), at most so many times."""
    x = np.array(start, dtype=np.float64)
    error = residuals(x)
    cost, slope = float(error @ error) + belief.cost(x), jacobian(residuals, x, belief.step)
    for iteration in range(iterations):
        if iteration:
            slope = jacobian(residuals, x, belief.step)
        lower = _descend(residuals, x, gauss_newton_step(slope, error, x, belief), belief, cost)
        if lower is None:
            break
        gain, (x, error, cost) = cost - lower[2], lower
        if gain < _ENOUGH * cost:
            break
    return Optimum(x, cost, slope.T @ slope)


def gauss_newton_step(slope: np.ndarray, error: np.ndarray, x: np.ndarray, belief: Belief) -> np.ndarray:
    """(P,) from x to the least of c, if the residuals were linear with this (N, P) slope."""
    curvature = slope.T @ slope + np.diag(belief.deviation**-2)
    return -np.linalg.solve(curvature, slope.T @ error + (x - belief.mean) / belief.deviation**2)


def jacobian(residuals: Residuals, x: np.ndarray, step: np.ndarray) -> np.ndarray:
    """(N, P) by central differences."""
    columns = [(residuals(x + away) - residuals(x - away)) / (2.0 * away.max()) for away in np.diag(step)]
    return np.stack(columns, axis=1)


def _descend(
    residuals: Residuals, x: np.ndarray, step: np.ndarray, belief: Belief, cost: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """The first of ever shorter steps that lowers the cost."""
    for share in _SHARES:
        error = residuals(x + share * step)
        new = float(error @ error) + belief.cost(x + share * step)
        if new < cost:
            return x + share * step, error, new
    return None
