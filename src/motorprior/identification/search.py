"""One search for all fits: M least-squares problems, each with a Gaussian prior and lower bounds.

    minimise  U(x) = loss(x) + ½·Σ_k precision_k·(x_k - mean_k)²,
    loss = weight·mean of huber(residuals)

All M problems have the same number K of unknowns. A fit samples candidates, descends from the best
one by damped Gauss-Newton steps, and restarts until the best optimum of every problem was found
several times. Derivatives are central differences over a wide step, since stiction makes small
steps meaningless. A step is taken only if it lowers the energy U, so no fit diverges.

All problems advance together, which fills the lanes of a compiled simulation. A problem that is
done drops out.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, TypeAlias

import numpy as np

from motorprior.compiled import njit
from motorprior.identification.checkpoint import Arrays, PartCheckpoint, unsaved_part

# step of the central differences, in unknowns: logarithms of constants, or N(0, 1)
WIDE = 0.1
NARROW = 0.03
MAX_STEP = 0.5  # maximum change of an unknown in one Gauss-Newton step
# factors on the damping, all tried in every step
DAMPINGS = 10.0 ** np.array([-1.5, -0.75, 0.0, 0.75, 1.5])
# two optima are the same if their energies differ by less than this share
SAME_OPTIMUM = 3e-3
CONFIRMATIONS = 2  # times that an optimum must be found again
_MIN_DECREASE = 1e-4  # share of U; a descent ends after a step that lowers U by less
_LANES = 768  # simulations at a time; bounds the memory
# number of concurrent descents; if few problems are left, several restarts of each descend together
_CONCURRENT_DESCENTS = 8
_DIVERGED_LOSS = 1e9
_DIVERGED_RESIDUAL = 1e6
_DIVERGED_SLOPE = 1e15  # sums of squares of float32 slopes above it may be infinite
FIXED = 1e6  # precision of a fixed unknown
CORES = os.cpu_count() or 1

Steps: TypeAlias = tuple[tuple[int, float], ...]
"""Descents one after the other: for each, the maximum number of steps and the difference step."""


def threads() -> ThreadPoolExecutor:
    """Thread pool shared by all searches of this process. Tasks must not wait for each other."""
    return _threads_of(os.getpid())  # a forked process has no threads of its parent


@cache
def _threads_of(process: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(CORES)


def huber(x: Any) -> Any:
    """Pseudo-Huber loss √(1 + x²) - 1.

    It is linear for large |x|, so that one diverged window does not dominate a batch.
    """
    return (1.0 + x * x) ** 0.5 - 1.0


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _sums(
    slopes: np.ndarray, pulls: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over residuals r: Σ slopes·pulls (K,) and Σ weights·slopes·slopesᵀ (K, K).

    The order of the additions is the same for any number of threads.
    """
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
    """Independent Gaussians of the unknowns x.

    Mean and precision are (K,), the same for all problems, or (M, K).
    """

    mean: np.ndarray
    precision: np.ndarray

    def fixing(self, columns: np.ndarray) -> "GaussianPrior":
        """Prior that fixes the unknowns of these ``columns`` (K,) at 0."""
        return GaussianPrior(
            np.where(columns, 0.0, self.mean), np.where(columns, FIXED, self.precision)
        )

    def subset(self, problems: np.ndarray) -> "GaussianPrior":
        """Prior of the problems with these indices (m,)."""
        mean = self.mean if self.mean.ndim == 1 else self.mean[problems]
        precision = self.precision if self.precision.ndim == 1 else self.precision[problems]
        return GaussianPrior(mean, precision)

    def energy(self, x: np.ndarray) -> np.ndarray:
        """(M, ...) energy ½·Σ precision·(x - mean)² of unknowns x (M, ..., K)."""
        mean = np.atleast_2d(self.mean)[:, None]
        precision = np.atleast_2d(self.precision)[:, None]

        points = x.reshape(len(x), -1, x.shape[-1])
        energy = 0.5 * np.sum(precision * (points - mean) ** 2, axis=-1)
        return energy.reshape(x.shape[:-1])


@dataclass(frozen=True)
class Fit:
    """Current point of M problems."""

    x: np.ndarray  # (M, K) unknowns
    energy: np.ndarray  # (M,) U
    loss: np.ndarray  # (M,)

    def better(self, other: "Fit") -> "Fit":
        """The fit with less energy, for every problem."""
        improved = np.flatnonzero(other.energy < self.energy)
        return self.replaced(improved, other.subset(improved))

    def subset(self, problems: np.ndarray) -> "Fit":
        """Fit of the problems with these indices (m,)."""
        return Fit(self.x[problems], self.energy[problems], self.loss[problems])

    def replaced(self, problems: np.ndarray, replacement: "Fit") -> "Fit":
        """This fit, with ``replacement``, a fit of m problems, in place of ``problems`` (m,)."""
        x = self.x.copy()
        energy = self.energy.copy()
        loss = self.loss.copy()

        x[problems] = replacement.x
        energy[problems] = replacement.energy
        loss[problems] = replacement.loss
        return Fit(x, energy, loss)


class Problem(Protocol):
    """M least-squares problems of one shape."""

    count: int  # M
    weight: float  # factor of the loss
    observations: int  # N; residuals are split into N equal observations

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, R) residuals of L lanes: of problem ``problems[l]`` at unknowns x[l], x is (L, K).

        Residuals of one observation are consecutive. A lane whose residuals are not all finite
        counts as diverged.
        """
        ...


class Search:
    """Searches and descents for the problems of one `Problem`.

    ``lower`` (M, K) bounds candidates, not descents. ``checkpoint`` saves the results of `descend`
    and `best_of`.
    """

    def __init__(
        self,
        problem: Problem,
        lower: np.ndarray | None = None,
        checkpoint: PartCheckpoint = unsaved_part,
    ):
        self.problem = problem
        self._lower = lower
        self._checkpoint = checkpoint
        self.all_problems = np.arange(problem.count)

    def losses(self, x: np.ndarray, problems: np.ndarray | None = None) -> np.ndarray:
        """(m, ...) losses at unknowns x (m, ..., K) of ``problems`` (m,), or of all problems."""
        problems = self.all_problems if problems is None else problems
        shape = x.shape[:-1]

        # one lane per point: every problem is repeated for all its points
        rows = x.reshape(-1, x.shape[-1])
        lane_problems = problems.reshape(-1, *[1] * (x.ndim - 2))
        lane_problems = np.broadcast_to(lane_problems, shape).ravel()

        losses = np.empty(len(rows))
        for first in range(0, len(rows), _LANES):
            lanes = slice(first, first + _LANES)
            residuals = self._residuals(rows[lanes], lane_problems[lanes])
            chunks = np.array_split(residuals, CORES)
            losses[lanes] = np.concatenate(list(threads().map(self._loss_of, chunks)))
        return losses.reshape(shape)

    def observation_losses(self, x: np.ndarray) -> np.ndarray:
        """(M, N) loss of every observation at unknowns x (M, K)."""
        residuals = []
        for index in self.all_problems:
            residuals.append(self._residuals(x[[index]], np.array([index])))

        by_observation = np.concatenate(residuals).reshape(len(x), self.problem.observations, -1)
        return self._loss_of(by_observation.astype(np.float64))

    def _loss_of(self, residuals: np.ndarray) -> np.ndarray:
        """(...) losses of residuals (..., R)."""
        with np.errstate(over="ignore", invalid="ignore"):
            mean = np.mean(huber(residuals), axis=-1, dtype=np.float64)
            loss = self.problem.weight * mean
        return np.where(np.isfinite(loss), loss, _DIVERGED_LOSS)

    def _residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, R) residuals of the lanes; a diverged simulation may overflow."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.problem.residuals(x, problems).reshape(len(problems), -1)

    def at(self, x: np.ndarray, prior: GaussianPrior, problems: np.ndarray | None = None) -> Fit:
        """The fit at unknowns x (m, K) of ``problems`` (m,), or of all, with their ``prior``."""
        loss = self.losses(x, problems)
        return Fit(x, loss + prior.energy(x), loss)

    def best_of(
        self, candidates: np.ndarray, prior: GaussianPrior, problems: np.ndarray | None = None
    ) -> np.ndarray:
        """(m, K) candidate with the lowest energy of each of the ``problems`` (m,), or of all.

        ``candidates`` (m, C, K) below the lower bounds are raised to these; ``prior`` covers all M
        problems.
        """
        problems = self.all_problems if problems is None else problems
        if self._lower is not None:
            candidates = np.maximum(candidates, self._lower[problems][:, None])

        def best() -> Arrays:
            energy = self.losses(candidates, problems) + prior.subset(problems).energy(candidates)
            return {"index": energy.argmin(axis=1)}

        return candidates[np.arange(len(problems)), self._checkpoint(best)["index"]]

    def descend(
        self,
        start: np.ndarray,
        prior: GaussianPrior,
        steps: Steps,
        problems: np.ndarray | None = None,
    ) -> Fit:
        """Damped Gauss-Newton steps from ``start`` (m, K) for ``problems`` (m,), or for all.

        The descent of a problem ends after a step that lowers its energy by less than
        _MIN_DECREASE. ``prior`` covers all M problems.
        """
        problems = self.all_problems if problems is None else problems
        prior = prior.subset(problems)

        def descended() -> Arrays:
            fit = self.at(start, prior, problems)
            for max_steps, diff_step in steps:
                fit = self._descend(fit, prior, max_steps, diff_step, problems)
            return {"x": fit.x, "energy": fit.energy, "loss": fit.loss}

        return Fit(**self._checkpoint(descended))

    def _descend(
        self,
        start: Fit,
        prior: GaussianPrior,
        max_steps: int,
        diff_step: float,
        problems: np.ndarray,
    ) -> Fit:
        """One descent of ``problems`` (m,) from their fits, with differences over ``diff_step``."""
        x = start.x
        energy = start.energy
        loss = start.loss
        rows = np.arange(len(problems))

        # the derivatives of unknowns that are fixed in all problems are not needed
        other_axes = tuple(range(prior.precision.ndim - 1))
        free = np.flatnonzero(np.any(prior.precision < FIXED, axis=other_axes))
        slope, curvature = self._derivatives(x, diff_step, problems, free)

        damping = np.full(len(problems), 1e-2)
        active = rows  # problems whose descent has not ended
        for step in range(max_steps):
            # every step tries several dampings at once, for all problems
            dampings = damping[:, None] * DAMPINGS
            candidates = x[:, None] - _moves(x, slope, curvature, prior, dampings)
            losses = np.full(candidates.shape[:2], np.inf)
            losses[active] = self.losses(candidates[active], problems[active])
            energies = losses + prior.energy(candidates)
            best = energies.argmin(axis=1)
            min_energy = energies[rows, best]

            # a step is taken only if it lowers the energy; otherwise the damping grows
            lowers = min_energy < energy
            next_damping = np.where(lowers, dampings[rows, best], 30.0 * damping)
            damping = np.clip(next_damping, 1e-6, 1e4)
            converged = lowers & (energy - min_energy < _MIN_DECREASE * energy)
            x = np.where(lowers[:, None], candidates[rows, best], x)
            loss = np.where(lowers, losses[rows, best], loss)
            energy = np.where(lowers, min_energy, energy)

            active = active[~converged[active]]
            if not len(active):
                break

            # derivatives stay valid for problems that did not move
            moved = active[lowers[active]]
            if step + 1 < max_steps and len(moved):
                slope[moved], curvature[moved] = self._derivatives(
                    x[moved], diff_step, problems[moved], free
                )
        return Fit(x, energy, loss)

    def until_found_again(
        self,
        best: Fit,
        prior: GaussianPrior,
        draw: Callable[[int, Fit], np.ndarray],
        restarts: int,
        steps: Steps,
        report: Callable[[], None] = lambda: None,
        problems: np.ndarray | None = None,
        confirmations: int = CONFIRMATIONS,
    ) -> Fit:
        """Restart ``problems`` (m,), or all, until the best optimum of each is confirmed.

        Args:
            best: fit of all M problems to start from.
            prior: of all M problems.
            draw: gives candidates (M, C, K) from the number of the restart and the best fit so far.
            restarts: maximum number.
            steps: of the descent of each restart.
            report: called ``restarts`` times.
            problems: indices of the problems that are searched; the others keep their fit.
            confirmations: times that the best optimum of a problem must be found again.

        Returns:
            The best fit of all M problems.
        """
        searched = self.all_problems if problems is None else problems
        # (M,) how often the optimum was found again; a problem that is not searched is confirmed
        confirmed = np.full(len(best.x), confirmations)
        confirmed[searched] = 0

        done = 0
        while done < restarts:
            active = np.flatnonzero(confirmed < confirmations)
            if not len(active):
                break

            # several restarts of few problems descend together
            batch = min(restarts - done, max(1, _CONCURRENT_DESCENTS // len(active)))
            starts = []
            for restart in range(done, done + batch):
                candidates = draw(restart, best)[active]
                starts.append(self.best_of(candidates, prior, active))
            fits = self.descend(np.concatenate(starts), prior, steps, np.tile(active, batch))

            for index in range(batch):
                fit = fits.subset(np.arange(len(active)) + index * len(active))
                old_energy = best.energy[active]
                is_same = np.abs(fit.energy - old_energy) <= SAME_OPTIMUM * old_energy
                is_better = fit.energy < (1.0 - SAME_OPTIMUM) * old_energy

                # a better optimum starts the count again; a confirmed one stays confirmed
                counted = np.where(is_better, 0, confirmed[active] + is_same)
                is_open = confirmed[active] < confirmations
                confirmed[active] = np.where(is_open, counted, confirmations)
                best = best.replaced(active, best.subset(active).better(fit))
                report()
            done += batch

        for _ in range(restarts - done):
            report()
        return best

    def curvatures(
        self, x: np.ndarray, diff_step: float = NARROW, problems: np.ndarray | None = None
    ) -> np.ndarray:
        """(m, K, K) Gauss-Newton matrices of the loss at unknowns x (M, K) of ``problems`` (m,).

        They are weight·mean of huber''(r)·∇r·∇rᵀ, with huber''(r) = (1 + r²)^(-3/2). Without
        ``problems`` they are of all problems.
        """
        problems = self.all_problems if problems is None else problems
        every_unknown = np.arange(x.shape[1])
        _, curvature = self._derivatives(x[problems], diff_step, problems, every_unknown, -1.5)
        return curvature

    def _derivatives(
        self,
        x: np.ndarray,
        diff_step: float,
        problems: np.ndarray,
        free: np.ndarray,
        power: float = -0.5,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gradient (m, K) and Gauss-Newton matrix (m, K, K) of the loss of ``problems`` (m,).

        They are 0 for unknowns that are not ``free`` (indices). The matrix has (1 + r²)^power in
        place of huber''(r), which has a power of -3/2. The power -1/2, of huber'(r)/r, gives an
        upper bound.
        """
        size = x.shape[1]
        slope = np.zeros((len(problems), size))
        curvature = np.zeros((len(problems), size, size))

        # points of the differences: the middle, then each free unknown above, then below
        directions = np.eye(size)[free]
        shifts = diff_step * np.concatenate([np.zeros((1, size)), directions, -directions])
        points = len(shifts)

        def sums_of(residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return _gauss_newton_sums(residuals, diff_step, power)

        batch = max(1, _LANES // points)
        for first in range(0, len(problems), batch):
            rows = slice(first, first + batch)
            lanes = (x[rows][:, None] + shifts).reshape(-1, size)
            residuals = self._residuals(lanes, np.repeat(problems[rows], points))
            residuals = residuals.reshape(-1, points, residuals.shape[1])

            factor = self.problem.weight / residuals.shape[2]
            for row, (gradient, matrix) in enumerate(threads().map(sums_of, residuals), first):
                slope[row, free] = factor * gradient
                curvature[row][np.ix_(free, free)] = factor * matrix
        return slope, curvature


def _gauss_newton_sums(
    residuals: np.ndarray, diff_step: float, power: float
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over the residuals of one problem: gradient (F,) and matrix (F, F) of F free unknowns.

    ``residuals`` (1 + 2·F, R) are in rows: the middle, each unknown above it, each unknown below.
    Residuals that diverge at any of these points do not count.
    """
    count = (len(residuals) - 1) // 2
    with np.errstate(over="ignore", invalid="ignore"):
        middle = residuals[0]
        above = residuals[1 : count + 1]
        below = residuals[count + 1 :]
        slopes = (above - below) / np.float32(2.0 * diff_step)
        is_small = np.abs(middle) < _DIVERGED_RESIDUAL
        usable = is_small & (np.abs(slopes) < _DIVERGED_SLOPE).all(axis=0)
    middle = np.where(usable, middle, 0.0)
    slopes = np.where(usable, slopes, 0.0)

    squares = 1.0 + middle * middle
    huber_slope = squares**-0.5 * middle
    return _sums(slopes, huber_slope, squares**power)


def _moves(
    x: np.ndarray,
    slope: np.ndarray,
    curvature: np.ndarray,
    prior: GaussianPrior,
    dampings: np.ndarray,
) -> np.ndarray:
    """(M, D, K) Gauss-Newton steps, to be subtracted from x (M, K), with ``dampings`` (M, D)."""
    # of the energy: loss and prior
    identity = np.eye(x.shape[1])
    matrix = curvature + prior.precision[..., None] * identity
    gradient = slope + prior.precision * (x - prior.mean)

    # Levenberg-Marquardt: the damping of an unknown is relative to its curvature, but not below
    # a share of the largest one
    diagonal = np.einsum("mpp->mp", matrix)
    scale = diagonal + 1e-3 * diagonal.max(axis=1, keepdims=True) + 1e-12
    damping = (dampings[..., None] * scale[:, None])[..., None] * identity
    damped = matrix[:, None] + damping

    right_side = np.broadcast_to(gradient[:, None, :, None], (*damped.shape[:3], 1))
    moves = np.linalg.solve(damped, right_side)[..., 0]
    return np.clip(moves, -MAX_STEP, MAX_STEP)
