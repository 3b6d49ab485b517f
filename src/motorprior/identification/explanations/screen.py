"""Score test: the share of the errors that an explanation can leave, without fitting it.

At the fitted motor, with residuals r, an explanation with the parameters θ changes r by S·θ, and
the constants change it by J·x. To first order, the explanation leaves the share

    |r⊥ - S⊥·(S⊥⁺·r⊥)| / |r⊥|

of the errors, where ⊥ removes what the constants can explain (the columns of J), and S⁺ is the
pseudo-inverse. S are differences over a small and over a large change of θ, since a large error
of the inputs changes r in another direction than a small one. If the effect of θ may be the same
for both signs, the differences over the large change are also to either side. Residuals are
weighted by the Huber weights at the fitted motor.

The test costs a few simulations per explanation and shares J, where a fit needs hundreds.
"""

from dataclasses import dataclass

import numpy as np

from motorprior.identification.search import WIDE, Problem

_CHANGES = (0.1, 1.0)  # of the parameters, over their units
_MIN_SINGULAR = 1e-3  # of directions of J, relative to the largest one
_MAX_RESIDUAL = 1e4  # residuals beyond are of a simulation that diverges


def sensitivities(
    problem: Problem, x: np.ndarray, index: int, columns: np.ndarray, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (R,) of a problem at the unknowns x (K,), and their derivatives (F, R).

    Derivatives with respect to the unknowns with the indices ``columns`` (F,) are central
    differences over ±``step``; they are 0 where a simulation diverges.
    """
    moves = step * np.eye(len(x))[columns]
    points = np.concatenate([x[None], x + moves, x - moves])
    residuals = _residuals(problem, points, index)
    above, below = np.split(residuals[1:], 2)
    return residuals[0], (above - below) / (2.0 * step)


def _residuals(problem: Problem, points: np.ndarray, index: int) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        residuals = problem.residuals(points, np.full(len(points), index))
    residuals = residuals.reshape(len(points), -1).astype(np.float64)
    return np.where(np.abs(residuals) < _MAX_RESIDUAL, residuals, 0.0)


@dataclass(frozen=True)
class Unexplained:
    """Residuals of one fitted motor that its constants cannot explain."""

    x: np.ndarray  # (K,) unknowns of the fitted motor
    residuals: np.ndarray  # (R,) r
    weights: np.ndarray  # (R,) square roots of the Huber weights
    basis: np.ndarray  # (R, B) orthonormal basis of the weighted columns of J

    @property
    def left(self) -> np.ndarray:
        """(R,) weighted residuals r⊥."""
        return self.without_constants(self.weights * self.residuals)

    def without_constants(self, weighted: np.ndarray) -> np.ndarray:
        """Weighted changes (R, ...) without what the constants explain."""
        return weighted - self.basis @ (self.basis.T @ weighted)


def unexplained(problem: Problem, x: np.ndarray, index: int, free: np.ndarray) -> Unexplained:
    """Residuals of a motor at x (K,) that its ``free`` constants (indices) cannot explain."""
    residuals, slopes = sensitivities(problem, x, index, free, WIDE)
    weights = (1.0 + residuals**2) ** -0.25
    vectors, sizes, _ = np.linalg.svd((weights * slopes).T, full_matrices=False)
    is_used = sizes > _MIN_SINGULAR * sizes.max(initial=1e-12)
    return Unexplained(x, residuals, weights, vectors[:, is_used])


def predicted_share(
    problem: Problem, motor: Unexplained, index: int, parameters: int, is_even: bool = False
) -> tuple[float, np.ndarray]:
    """Share of the errors that an explanation leaves, and its parameters (P,) over their units.

    ``problem`` has the explanation's P parameters as its last unknowns. The parameters are the
    linear estimate of a small change, or of a large one to one side if the effect may be the same
    for both signs of a parameter (``is_even``) and this explains more.
    """
    left = motor.left
    size = max(float(np.linalg.norm(left)), 1e-12)
    start = np.append(motor.x, np.zeros(parameters))
    columns = np.arange(len(motor.x), len(start))

    def explained(slopes: np.ndarray) -> tuple[float, np.ndarray]:
        directions = motor.without_constants((motor.weights * slopes).T)
        solution = np.linalg.lstsq(directions, left, rcond=1e-6)[0]
        return float(np.linalg.norm(left - directions @ solution)) / size, -solution

    shares = []
    estimate = np.zeros(parameters)
    for change in _CHANGES:
        _, slopes = sensitivities(problem, start, index, columns, change)
        share, parameter_values = explained(slopes)
        shares.append(share)
        if change == _CHANGES[0]:
            estimate = parameter_values
    if is_even:
        for slopes in _slopes_to_sides(problem, start, index, columns):
            share, parameter_values = explained(slopes)
            if share < min(shares):
                estimate = parameter_values
            shares.append(share)
    return min(shares), estimate


def _slopes_to_sides(
    problem: Problem, x: np.ndarray, index: int, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(F, R) differences over the large change of F unknowns, above and below x (K,)."""
    change = _CHANGES[-1]
    moves = change * np.eye(len(x))[columns]
    residuals = _residuals(problem, np.concatenate([x[None], x + moves, x - moves]), index)
    above, below = np.split(residuals[1:], 2)
    return (above - residuals[0]) / change, (residuals[0] - below) / change
