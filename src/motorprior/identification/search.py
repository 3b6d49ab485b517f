"""One search for all fits: M least-squares problems of one shape, each with a Gaussian prior and lower bounds.

    minimise  U(x) = loss(x) + ½·Σ_k precision_k·(x_k - mean_k)²,    loss = weight·mean of huber(residuals)

A fit samples candidates, descends from the best one by damped Gauss-Newton steps, and restarts
until every problem's best optimum was found several times. Derivatives are central differences over
a wide step, since stiction makes small ones meaningless. A step is taken only if it lowers U: no
fit diverges. All problems advance together, which fills the lanes of a compiled simulation; a
problem that is done drops out.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, TypeAlias

import numpy as np

from motorprior.compiled import njit

# step of the central differences, in unknowns: logarithms of constants, or N(0, 1)
WIDE = 0.1
NARROW = 0.03
MAX_STEP = 0.5  # maximum change of an unknown in one Gauss-Newton step
# factors on the damping, all tried in every step
DAMPINGS = 10.0 ** np.array([-1.5, -0.75, 0.0, 0.75, 1.5])
# maximum relative difference of U; number, see `Search.until_found_again`
SAME_OPTIMUM = 3e-3
CONFIRMATIONS = 2
_MIN_GAIN = 1e-4  # share of U; a descent ends after a step that lowers it by less
_LANES = 768  # simulations at a time; bounds the memory
_TOGETHER = 8  # concurrent descents; when few problems are left, several restarts of each
_DIVERGED_LOSS = 1e9
_DIVERGED_RESIDUAL = 1e6
FIXED = 1e6  # precision of a fixed unknown
CORES = os.cpu_count() or 1
Steps: TypeAlias = tuple[tuple[int, float], ...]
"""Descents one after the other: maximum number of Gauss-Newton steps, and step of the differences, of each."""


def threads() -> ThreadPoolExecutor:
    """Of all searches of this process; a task must not wait for another one."""
    return _threads_of(os.getpid())  # a forked process has no threads of its parent


@cache
def _threads_of(process: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(CORES)


def huber(x: Any) -> Any:
    """Pseudo-Huber loss √(1 + x²) - 1: linear for large |x|, so that one diverged window does not dominate a batch."""
    return (1.0 + x * x) ** 0.5 - 1.0


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _sums(
    slopes: np.ndarray, pulls: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Σ_r slopes·pulls (K,) and Σ_r weights·slopes·slopesᵀ (K, K), in the same order for any number of threads."""
    size, count = slopes.shape
    gradient = np.zeros(size)
    matrix = np.zeros((size, size))
    for i in range(size):
        weighted = weights * slopes[i]
        total = np.float32(0.0)
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
    """Independent Gaussians of x of this mean and precision, each (K,) or (M, K)."""

    mean: np.ndarray
    precision: np.ndarray

    def fixing(self, columns: np.ndarray) -> "GaussianPrior":
        """The same with x fixed at 0 in these columns (K,)."""
        return GaussianPrior(
            np.where(columns, 0.0, self.mean), np.where(columns, FIXED, self.precision)
        )

    def subset(self, which: np.ndarray) -> "GaussianPrior":
        """The prior of some of the problems (m,)."""
        return GaussianPrior(
            *(each if each.ndim == 1 else each[which] for each in (self.mean, self.precision))
        )

    def energy(self, x: np.ndarray) -> np.ndarray:
        """(M, ...) ½·Σ precision·(x - mean)² of x (M, ..., K)."""
        mean, precision = (np.atleast_2d(values)[:, None] for values in (self.mean, self.precision))
        away = x.reshape(len(x), -1, x.shape[-1]) - mean
        return 0.5 * np.sum(precision * away**2, axis=-1).reshape(x.shape[:-1])


@dataclass(frozen=True)
class Fit:
    """Current point of M problems: x (M, K), energy U (M,) and loss (M,)."""

    x: np.ndarray
    energy: np.ndarray
    loss: np.ndarray

    def better(self, other: "Fit") -> "Fit":
        """The fit with less energy, for every problem."""
        lower = np.flatnonzero(other.energy < self.energy)
        return self.replaced(lower, other.subset(lower))

    def subset(self, which: np.ndarray) -> "Fit":
        """The fit of some of the problems (m,)."""
        return Fit(self.x[which], self.energy[which], self.loss[which])

    def replaced(self, which: np.ndarray, some: "Fit") -> "Fit":
        """The same with the fits of these problems (m,) replaced."""
        found = Fit(*(values.copy() for values in vars(self).values()))
        for values, others in zip(vars(found).values(), vars(some).values(), strict=True):
            values[which] = others
        return found


class Problem(Protocol):
    """M problems: ``residuals(x (L, K), which (L,))`` gives (L, R) of problem ``which[l]`` at x[l].

    Residuals of one observation are consecutive. One that is not finite counts as diverged.
    """

    count: int  # M
    weight: float  # factor of the loss
    observations: int  # N; residuals are split into N equal observations

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """See above."""
        ...


class Search:
    """Searches and descents for the problems of one `Problem`; ``lower`` (M, K) bounds candidates, not descents."""

    def __init__(self, problem: Problem, lower: np.ndarray | None = None):
        self.problem = problem
        self._lower = lower
        self.all_problems = np.arange(problem.count)

    def losses(self, x: np.ndarray, which: np.ndarray | None = None) -> np.ndarray:
        """(...) loss of problem x[m, ...]; x is (M, ..., K), of the problems ``which`` (M,) or of all."""
        shape = x.shape[:-1]
        which = self.all_problems if which is None else which
        lanes = np.broadcast_to(which.reshape(-1, *[1] * (x.ndim - 2)), shape).ravel()
        rows = x.reshape(-1, x.shape[-1])
        found = np.empty(len(lanes))
        for first in range(0, len(lanes), _LANES):
            some = slice(first, first + _LANES)
            values = np.array_split(self._residuals(rows[some], lanes[some]), CORES)
            found[some] = np.concatenate(list(threads().map(self.loss_of, values)))
        return found.reshape(shape)

    def parts(self, x: np.ndarray) -> np.ndarray:
        """(M, N) loss of every observation at x (M, K)."""
        values = np.concatenate(
            [self._residuals(x[[one]], np.array([one])) for one in self.all_problems]
        )
        return self.loss_of(
            values.reshape(len(x), self.problem.observations, -1).astype(np.float64)
        )

    def loss_of(self, residuals: np.ndarray) -> np.ndarray:
        """(...) loss of residuals (..., R)."""
        with np.errstate(over="ignore", invalid="ignore"):
            loss = self.problem.weight * np.mean(huber(residuals), axis=-1, dtype=np.float64)
        return np.where(np.isfinite(loss), loss, _DIVERGED_LOSS)

    def _residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore", invalid="ignore"):
            return self.problem.residuals(x, which).reshape(len(which), -1)

    def at(self, x: np.ndarray, prior: GaussianPrior, which: np.ndarray | None = None) -> Fit:
        """The fit at x (m, K) of the problems ``which`` (m,), or of all, with their prior."""
        loss = self.losses(x, which)
        return Fit(x, loss + prior.energy(x), loss)

    def best_of(
        self, candidates: np.ndarray, prior: GaussianPrior, which: np.ndarray | None = None
    ) -> np.ndarray:
        """(m, K) candidate with the lowest energy for each problem; candidates (m, C, K) are raised to the bounds."""
        which = self.all_problems if which is None else which
        if self._lower is not None:
            candidates = np.maximum(candidates, self._lower[which][:, None])
        energy = self.losses(candidates, which) + prior.subset(which).energy(candidates)
        return candidates[np.arange(len(which)), energy.argmin(axis=1)]

    def descend(
        self, start: np.ndarray, prior: GaussianPrior, steps: Steps, which: np.ndarray | None = None
    ) -> Fit:
        """Damped Gauss-Newton steps from ``start`` (m, K); each ends once one lowers U by less than _MIN_GAIN."""
        which = self.all_problems if which is None else which
        prior = prior.subset(which)
        found = self.at(start, prior, which)
        for count, diff_step in steps:
            found = self._descend(found, prior, count, diff_step, which)
        return found

    def _descend(
        self, found: Fit, prior: GaussianPrior, steps: int, diff_step: float, which: np.ndarray
    ) -> Fit:
        x = found.x
        energy = found.energy
        loss = found.loss
        rows = np.arange(len(which))
        damping = np.full(len(which), 1e-2)
        free = np.flatnonzero(
            np.any(prior.precision < FIXED, axis=tuple(range(prior.precision.ndim - 1)))
        )
        slope, curvature = self._derivatives(x, diff_step, which, free)
        left = rows
        for step in range(steps):
            tried = damping[:, None] * DAMPINGS
            candidates = x[:, None] - _moves(x, slope, curvature, prior, tried)
            losses = np.full(candidates.shape[:2], np.inf)
            losses[left] = self.losses(candidates[left], which[left])
            energies = losses + prior.energy(candidates)
            best = energies.argmin(axis=1)
            min_energy = energies[rows, best]
            lower = min_energy < energy
            damping = np.clip(np.where(lower, tried[rows, best], 30.0 * damping), 1e-6, 1e4)
            done = lower & (energy - min_energy < _MIN_GAIN * energy)
            x = np.where(lower[:, None], candidates[rows, best], x)
            loss = np.where(lower, losses[rows, best], loss)
            energy = np.where(lower, min_energy, energy)
            left = left[~done[left]]
            if not len(left):
                break
            if step + 1 < steps and len(moved := left[lower[left]]):
                slope[moved], curvature[moved] = self._derivatives(
                    x[moved], diff_step, which[moved], free
                )
        return Fit(x, energy, loss)

    def until_found_again(
        self,
        found: Fit,
        prior: GaussianPrior,
        draw: Callable[[int, Fit], np.ndarray],
        restarts: int,
        steps: Steps,
        report: Callable[[], None] = lambda: None,
        which: np.ndarray | None = None,
        again: int = CONFIRMATIONS,
    ) -> Fit:
        """Restart the problems ``which`` (m,), or all, until each one's best optimum was found ``again`` times more.

        ``draw`` gives candidates (M, C, K) from the number of the restart and the best fit so far.
        ``report`` is called ``restarts`` times, the maximum number.
        """
        times = np.full(len(found.x), again)
        done = 0
        times[self.all_problems if which is None else which] = 0
        while done < restarts and len(left := np.flatnonzero(times < again)):
            batch = min(restarts - done, max(1, _TOGETHER // len(left)))
            starts = [self.best_of(draw(done + k, found)[left], prior, left) for k in range(batch)]
            fits = self.descend(np.concatenate(starts), prior, steps, np.tile(left, batch))
            for k in range(batch):
                fit = fits.subset(np.arange(len(left)) + k * len(left))
                before = found.energy[left]
                same = np.abs(fit.energy - before) <= SAME_OPTIMUM * before
                counted = np.where(
                    fit.energy < (1.0 - SAME_OPTIMUM) * before, 0, times[left] + same
                )
                times[left] = np.where(times[left] < again, counted, again)
                found = found.replaced(left, found.subset(left).better(fit))
                report()
            done += batch
        for _ in range(restarts - done):
            report()
        return found

    def curvatures(self, x: np.ndarray, diff_step: float = NARROW) -> np.ndarray:
        """(M, K, K) Gauss-Newton matrices of the loss: weight·mean of (1 + r²)^(-3/2)·∇r·∇rᵀ, with huber''(r)."""
        return self._derivatives(x, diff_step, self.all_problems, np.arange(x.shape[1]), -1.5)[1]

    def _derivatives(
        self,
        x: np.ndarray,
        diff_step: float,
        which: np.ndarray,
        free: np.ndarray,
        power: float = -0.5,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (m, K) and Gauss-Newton matrix (m, K, K) of the loss of problems ``which`` (m,).

        They are 0 for unknowns that are not ``free`` (indices). The matrix has (1 + r²)^power in
        place of huber''(r), which has a power of -3/2; that of -1/2, of huber'(r)/r, gives an upper
        bound.
        """
        size = x.shape[1]
        slope = np.zeros((len(which), size))
        curvature = np.zeros((len(which), size, size))
        away = np.eye(size)[free]
        count = len(free)
        shifts = diff_step * np.concatenate([np.zeros((1, size)), away, -away])
        together = max(1, _LANES // len(shifts))
        for first in range(0, len(which), together):
            some = slice(first, first + together)
            lanes = (x[some][:, None] + shifts).reshape(-1, size)
            values = self._residuals(lanes, np.repeat(which[some], len(shifts)))
            found = values.reshape(-1, len(shifts), values.shape[1])

            def of_one(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
                with np.errstate(over="ignore", invalid="ignore"):
                    here = values[0]
                    above = values[1 : count + 1]
                    below = values[count + 1 :]
                    slopes = (above - below) / np.float32(2.0 * diff_step)
                    usable = (np.abs(here) < _DIVERGED_RESIDUAL) & np.isfinite(slopes).all(axis=0)
                here = np.where(usable, here, 0.0)
                slopes = np.where(usable, slopes, 0.0)
                squares = 1.0 + here * here
                return _sums(slopes, squares**-0.5 * here, squares**power)

            factor = self.problem.weight / found.shape[2]
            for row, (gradient, matrix) in enumerate(threads().map(of_one, found), first):
                slope[row, free] = factor * gradient
                curvature[row][np.ix_(free, free)] = factor * matrix
        return slope, curvature


def _moves(
    x: np.ndarray,
    slope: np.ndarray,
    curvature: np.ndarray,
    prior: GaussianPrior,
    damping: np.ndarray,
) -> np.ndarray:
    """(M, D, K) Gauss-Newton steps with each of the dampings (M, D)."""
    identity = np.eye(x.shape[1])
    matrix = curvature + prior.precision[..., None] * identity
    gradient = slope + prior.precision * (x - prior.mean)
    diagonal = np.einsum("mpp->mp", matrix)
    scale = diagonal + 1e-3 * diagonal.max(axis=1, keepdims=True) + 1e-12
    damped = matrix[:, None] + (damping[..., None] * scale[:, None])[..., None] * identity
    moves = np.linalg.solve(
        damped, np.broadcast_to(gradient[:, None, :, None], (*damped.shape[:3], 1))
    )[..., 0]
    return np.clip(moves, -MAX_STEP, MAX_STEP)
