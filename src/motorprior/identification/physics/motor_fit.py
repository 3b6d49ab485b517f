"""Fit of many motors at once, each to its own log, by free runs: a global search, then damped Gauss-Newton steps.

    minimise  U(z) = loss(z) + ½·Σ_k precision_k·(z_k - mean_k)²

per motor, with the rollout loss over all windows. Derivatives are central differences over a wide step, since
stiction makes small ones meaningless, and a step is taken only if it lowers U: no fit diverges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.compiled import njit
from motorprior.identification.physics.window_runs import WindowRuns, huber, huber_curvature, huber_weight

WIDE, NARROW = 0.1, 0.03  # step of the central differences, in latents: logarithms of constants, or N(0, 1)
MAX_STEP = 0.5  # of a latent, in one Gauss-Newton step
DAMPINGS = 10.0 ** np.array([-1.5, -0.75, 0.0, 0.75, 1.5])  # factors on the damping, all tried in every step
_MIN_GAIN = 1e-4  # share of U; a motor stops after a step that lowers it by less
_LANES = 768  # motors simulated at a time; bounds the memory
_DIVERGED_LOSS, _DIVERGED_RESIDUAL = 1e9, 1e6
_FIXED = 1e6  # precision of a fixed latent


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _sums(slopes: np.ndarray, pulls: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Σ_r slopes·pulls (Z,) and Σ_r weights·slopes·slopesᵀ (Z, Z), in the same order for any number of threads."""
    size, count = slopes.shape
    gradient, matrix = np.zeros(size), np.zeros((size, size))
    for i in range(size):
        weighted, total = weights * slopes[i], np.float32(0.0)
        for row in range(count):
            total += pulls[row] * slopes[i, row]
        gradient[i] = total
        for j in range(i + 1):
            total = np.float32(0.0)
            for row in range(count):
                total += weighted[row] * slopes[j, row]
            matrix[i, j] = matrix[j, i] = total
    return gradient, matrix


@dataclass(frozen=True)
class GaussianPrior:
    """Independent Gaussians of z of this mean and precision, each (Z,) or (M, Z)."""

    mean: np.ndarray
    precision: np.ndarray

    def fixing(self, columns: np.ndarray) -> GaussianPrior:
        """The same with z fixed at 0 in these columns (Z,)."""
        return GaussianPrior(np.where(columns, 0.0, self.mean), np.where(columns, _FIXED, self.precision))

    def energy(self, z: np.ndarray) -> np.ndarray:
        """(M, ...) ½·Σ precision·(z - mean)² of z (M, ..., Z)."""
        mean, precision = (_broadcast(values, z) for values in (self.mean, self.precision))
        return 0.5 * np.sum(precision * (z - mean) ** 2, axis=-1)


def _broadcast(values: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Values (Z,) or (M, Z) in a shape that broadcasts with z (M, ..., Z)."""
    return values if values.ndim == 1 else values.reshape(len(values), *[1] * (z.ndim - 2), -1)


@dataclass(frozen=True)
class Fit:
    """Current point of M motors: z (M, Z), energy U (M,) and loss (M,)."""

    z: np.ndarray
    energy: np.ndarray
    loss: np.ndarray

    def better(self, other: Fit) -> Fit:
        """The fit with less energy, for every motor."""
        chosen = other.energy < self.energy
        both = zip(vars(self).values(), vars(other).values(), strict=True)
        return Fit(*(select(chosen, others, values) for values, others in both))


def select(chosen: np.ndarray, values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(M, ...) ``values`` of the motors (M,) that are chosen, and ``others`` of the rest."""
    return np.where(chosen.reshape(-1, *[1] * (values.ndim - 1)), values, others)


class MotorFit:
    """The fit of M motors.

    Args:
        network: decoder from z to motors.
        runs: the logs.
        chosen: (N,) mask of the windows that count; all if not given.
        lower: (M, Z) lower bounds of z in random searches and restarts, not in Gauss-Newton steps; none if not given.
    """

    def __init__(
        self,
        network: LatentNetwork,
        runs: WindowRuns,
        chosen: np.ndarray | None = None,
        lower: np.ndarray | None = None,
    ):
        self.network, self.runs, self._lower = network, runs, lower
        self._chosen = slice(None) if chosen is None else np.flatnonzero(chosen)
        self._everyone = np.arange(runs.num_motors)

    @property
    def windows(self) -> int:
        """Number of windows of each motor that count."""
        return len(np.arange(self.runs.windows)[self._chosen])

    def _residuals(self, z: np.ndarray, motor: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            found = self.runs.residuals(self.network, z, motor)[:, self._chosen]
        return found.reshape(len(motor), -1)

    def losses(self, z: np.ndarray, motors: np.ndarray | None = None) -> np.ndarray:
        """(...) loss of motor z[m, ...] on its own log; z is (M, ..., Z), of these ``motors`` (M,) or of all."""
        shape, motors = z.shape[:-1], self._everyone if motors is None else motors
        motor = np.broadcast_to(motors.reshape(-1, *[1] * (z.ndim - 2)), shape).ravel()
        rows, found = z.reshape(-1, z.shape[-1]), np.empty(len(motor))
        for first in range(0, len(motor), _LANES):
            some = slice(first, first + _LANES)
            found[some] = self._loss(self._residuals(rows[some], motor[some]))
        return found.reshape(shape)

    def window_losses(self, z: np.ndarray) -> np.ndarray:
        """(M, N) loss of each window at z (M, Z)."""
        everyone, shape = self._everyone, (len(z), self.windows, -1)
        values = np.concatenate([self._residuals(z[[motor]], everyone[[motor]]) for motor in everyone])
        return self._loss(values.reshape(shape).astype(np.float64))

    def _loss(self, residuals: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            loss = self.runs.channels * np.mean(huber(residuals), axis=-1, dtype=np.float64)
        return np.where(np.isfinite(loss), loss, _DIVERGED_LOSS)

    def best_of(self, candidates: np.ndarray, prior: GaussianPrior) -> np.ndarray:
        """(M, Z) candidate with the lowest energy for each motor; candidates (M, K, Z) are raised to the bounds."""
        if self._lower is not None:
            candidates = np.maximum(candidates, _broadcast(self._lower, candidates))
        energy = self.losses(candidates) + prior.energy(candidates)
        return candidates[self._everyone, energy.argmin(axis=1)]

    def search(
        self, rng: np.random.Generator, start: np.ndarray, prior: GaussianPrior, radii: tuple[float, ...], count: int
    ) -> np.ndarray:
        """(M, Z) best of a random search around ``start`` (M, Z), ``count`` samples per radius."""
        best = start
        for radius in radii:
            samples = radius * rng.standard_normal((count, start.shape[-1]))
            samples[0] = 0.0
            best = self.best_of(best[:, None] + samples, prior)
        return best

    def polish(self, start: np.ndarray, prior: GaussianPrior, steps: int, diff_step: float = NARROW) -> Fit:
        """Damped Gauss-Newton steps from ``start`` (M, Z); a motor stops when one lowers U by less than _MIN_GAIN.

        At most ``steps``, with derivatives over ``diff_step``, WIDE or NARROW.
        """
        z, damping = start, np.full(len(start), 1e-2)
        loss = self.losses(z)
        energy = loss + prior.energy(z)
        slope, curvature = self._derivatives(z, diff_step)
        left = self._everyone
        for step in range(steps):
            tried = damping[:, None] * DAMPINGS
            candidates = z[:, None] - self._moves(z, slope, curvature, prior, tried)
            losses = np.full(candidates.shape[:2], np.inf)
            losses[left] = self.losses(candidates[left], left)
            energies = losses + prior.energy(candidates)
            best = energies.argmin(axis=1)
            found = energies[self._everyone, best]
            lower = found < energy
            damping = np.clip(np.where(lower, tried[self._everyone, best], 30.0 * damping), 1e-6, 1e4)
            done = lower & (energy - found < _MIN_GAIN * energy)
            z = np.where(lower[:, None], candidates[self._everyone, best], z)
            loss, energy = np.where(lower, losses[self._everyone, best], loss), np.where(lower, found, energy)
            left = left[~done[left]]
            if not len(left):
                break
            if step + 1 < steps and len(moved := left[lower[left]]):
                slope[moved], curvature[moved] = self._derivatives(z, diff_step, moved)
        return Fit(z, energy, loss)

    def curvatures(self, z: np.ndarray, diff_step: float = NARROW) -> np.ndarray:
        """(M, Z, Z) Gauss-Newton matrices of the loss: channels·mean of huber''(r)·∇r·∇rᵀ."""
        return self._derivatives(z, diff_step, bend=huber_curvature)[1]

    def _moves(
        self, z: np.ndarray, slope: np.ndarray, curvature: np.ndarray, prior: GaussianPrior, damping: np.ndarray
    ) -> np.ndarray:
        matrix = curvature + prior.precision[..., None] * np.eye(z.shape[1])
        gradient = slope + prior.precision * (z - prior.mean)
        diagonal = np.einsum("mpp->mp", matrix)
        scale = diagonal + 1e-3 * diagonal.max(axis=1, keepdims=True) + 1e-12
        damped = matrix[:, None] + (damping[..., None] * scale[:, None])[..., None] * np.eye(z.shape[1])
        moves = np.linalg.solve(damped, np.broadcast_to(gradient[:, None, :, None], (*damped.shape[:3], 1)))[..., 0]
        return np.clip(moves, -MAX_STEP, MAX_STEP)

    def _derivatives(
        self, z: np.ndarray, diff_step: float, motors: np.ndarray | None = None, bend: Callable = huber_weight
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (M, Z) and Gauss-Newton matrix (M, Z, Z) of the loss, of these ``motors``.

        The matrix has ``bend`` in place of the second derivative: with `huber_weight` it is an upper bound.
        """
        motors, size = self._everyone if motors is None else motors, z.shape[1]
        slope, curvature = np.zeros((len(motors), size)), np.zeros((len(motors), size, size))
        shifts = diff_step * np.concatenate([np.zeros((1, size)), np.eye(size), -np.eye(size)])
        together = max(1, _LANES // len(shifts))
        for first in range(0, len(motors), together):
            some = motors[first : first + together]
            lanes = (z[some][:, None] + shifts).reshape(-1, size)
            found = self._residuals(lanes, np.repeat(some, len(shifts))).reshape(len(some), len(shifts), -1)
            for row, values in enumerate(found, first):
                with np.errstate(over="ignore", invalid="ignore"):
                    here, slopes = values[0], (values[1 : size + 1] - values[size + 1 :]) / np.float32(2.0 * diff_step)
                    usable = (np.abs(here) < _DIVERGED_RESIDUAL) & np.isfinite(slopes).all(axis=0)
                here, slopes = np.where(usable, here, 0.0), np.where(usable, slopes, 0.0)
                gradient, matrix = _sums(slopes, huber_weight(here) * here, bend(here))
                factor = self.runs.channels / len(here)
                slope[row], curvature[row] = factor * gradient, factor * matrix
        return slope, curvature
