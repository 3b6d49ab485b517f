"""Uncertainty of the constants of fitted motors, from their logs alone.

The fit minimises the loss U of a motor's windows. In the coordinates y of `actuator.estimates`, the
covariance of all its constants together is

    C = (H·S⁻¹·H + I/UNKNOWN_STD²)⁻¹,   S = S_time + 2·MODEL_ERROR/SCORE²·U·H

H is the Gauss-Newton matrix of U. Priors of the fit do not enter. S has two parts:

- S_time is the variation over time. With the gradient g_b that each of B blocks of the log adds to
  U, S_time = B/(B - 1)·Σ_b (g_b - ḡ)(g_b - ḡ)ᵀ, as of an M-estimator (Huber's sandwich), so that
  the scale of the residuals and their correlation within a block come from the misfit. Few blocks
  are shrunk towards c·H with the mean scale c = tr(H⁻¹·S_time)/K, by the share K/(K + B).
- The second part is the error of the model, the same in all blocks: the simulation, the loads and
  the grid are not exact, and the search ends a little beside the optimum. A 90 % interval therefore
  holds at least the values for which the other constants can be adjusted so that the loss is larger
  by at most the share MODEL_ERROR.

Play and compliance of a gear move the joint by an angle, as errors of the model do. A play b moves
it by b/2 to either side, and a compliance c by c·τ under the torque τ. The error e of a free run,
without the noise of the readings, therefore hides a play of 2·e and a compliance of e/τ, with RMS
values of e and τ. A 90 % interval reaches at least so far to both sides; other constants follow as
the joint covariance expects.

`estimate_profiles` checks this linearisation by other fits to the same logs. If the loss rises by
less than the quadratic approximation states, the standard deviation is scaled by the root of the
ratio.
"""

import numpy as np

from motorprior.actuator.estimates import SCORE, Estimates
from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR
from motorprior.actuator.grey_box import GreyBox
from motorprior.identification import windows as channel
from motorprior.identification.physics.estimate_coordinates import Coordinates
from motorprior.identification.physics.estimate_profiles import (
    MODEL_ERROR,
    profiled,
    with_other_plays,
)
from motorprior.identification.physics.motor_problem import fixed_constants, motor_search
from motorprior.identification.physics.window_runs import POSITION_SCALE, WindowRuns
from motorprior.identification.search import WIDE, Problem, Search
from motorprior.signals import rms

BLOCK = 1.0  # minimum duration of a block of a log [s]
UNKNOWN_STD = MAX_LOG_FACTOR  # of a constant that a log does not identify at all
MIN_EIGENVALUE = 1e-9  # of H, relative to its largest one: the accuracy of differences
_MIN_TORQUE = 1e-6  # on a joint without a load [N·m]


def estimates_of(model: GreyBox, x: np.ndarray, runs: WindowRuns) -> Estimates:
    """Joint uncertainty of the constants of the motors x (M, K), fitted to the logs ``runs``.

    ``model`` has one latent per constant and no copula.
    """
    fixed = fixed_constants(model.terms, runs)
    search = motor_search(model, runs)
    hidden = hidden_by_errors(search, runs, x)
    coordinates = Coordinates(model, runs, x, hidden)
    free = np.flatnonzero(~fixed)
    blocks = blocks_of(runs)
    losses = search.losses(x)
    min_stds = {}
    for name, sizes in hidden.items():
        column = coordinates.names.index(name)
        min_stds[column] = coordinates.half_width(column, sizes) / SCORE

    covariance = np.zeros((*x.shape, x.shape[1]))
    for motor in range(len(x)):
        curvature, scores = _derivatives(search, coordinates, motor, free, blocks)
        covariance[motor][np.ix_(free, free)] = joint_covariance(curvature, scores, losses[motor])
        for column, min_std in min_stds.items():
            covariance[motor] = _with_min_std(covariance[motor], column, min_std[motor])
    estimates = Estimates(covariance, coordinates.scale)
    estimates = profiled(search, coordinates, estimates, free, losses)
    if runs.at_rotor:
        estimates = with_other_plays(model, runs, coordinates, estimates, free, losses)
    return estimates


def joint_covariance(curvature: np.ndarray, scores: np.ndarray, loss: float) -> np.ndarray:
    """(K, K) covariance C from H (K, K), the gradients g (B, K) of blocks, and the loss U."""
    count, size = scores.shape
    eigenvalues, vectors = np.linalg.eigh(curvature)
    largest = max(eigenvalues.max(), np.finfo(float).tiny / MIN_EIGENVALUE)
    eigenvalues = np.maximum(eigenvalues, MIN_EIGENVALUE * largest)
    root = np.sqrt(eigenvalues)

    # S in the coordinates in which H is the identity
    deviations = (scores - scores.mean(axis=0)) @ vectors / root
    over_time = deviations.T @ deviations * count / max(count - 1, 1)
    scale = np.trace(over_time) / size
    share = size / (size + count)
    over_time = (1.0 - share) * over_time + share * scale * np.eye(size)
    total = over_time + 2.0 * MODEL_ERROR / SCORE**2 * loss * np.eye(size)

    half = (vectors * root).T
    information = half.T @ np.linalg.solve(total, half)
    return np.linalg.inv(information + np.eye(size) / UNKNOWN_STD**2)


def hidden_by_errors(search: Search, runs: WindowRuns, x: np.ndarray) -> dict[str, np.ndarray]:
    """(M,) play [rad] and compliance [rad/(N·m)] that the errors of the motors x (M, K) hide.

    They are by the names of the constants; the module docstring has the formulas.
    """
    noise = (runs.recorded(channel.POS) - runs.recorded(channel.READING)) / POSITION_SCALE
    mean_square = np.empty(len(x))
    for motor in range(len(x)):
        residuals = search.problem.residuals(x[[motor]], np.array([motor]))
        positions = residuals.reshape(len(runs.counted), runs.channels, -1)[:, 0]
        mean_square[motor] = np.mean(positions.astype(np.float64) ** 2)
    mean_square -= np.mean(noise**2, axis=(1, 2))
    error = POSITION_SCALE * np.sqrt(np.maximum(mean_square, 0.0))
    return {"backlash": 2.0 * error, "gear_stiffness": error / _load_torques(runs)}


def _load_torques(runs: WindowRuns) -> np.ndarray:
    """(M,) RMS of the torque J·q̈ - external torque on each joint [N·m]."""
    torques = []
    for segment in runs.segments:
        rows = segment.rows
        acceleration = np.gradient(rows[:, channel.VEL], runs.recipe.period, axis=0)
        external = rows[:, channel.EXTERNAL] + rows[:, channel.STIFFNESS] * rows[:, channel.POS]
        torques.append(rows[:, channel.INERTIA] * acceleration - external)
    return np.maximum(rms(np.concatenate(torques), axis=0), _MIN_TORQUE)


def _with_min_std(covariance: np.ndarray, column: int, min_std: float) -> np.ndarray:
    """(K, K) covariance with at least this standard deviation of one constant, if it is fitted.

    The other constants follow as the covariance expects.
    """
    variance = covariance[column, column]
    if variance == 0.0 or variance >= min_std**2:
        return covariance
    slope = covariance[:, column] / variance
    return covariance + (min_std**2 - variance) * np.outer(slope, slope)


def blocks_of(runs: WindowRuns) -> np.ndarray:
    """(N,) index of the block of each counted window: at least BLOCK seconds of one segment."""
    windows_per_block = max(1, round(BLOCK / (runs.recipe.window * runs.recipe.period)))
    blocks = []
    first = 0
    for segment in runs.segments:
        count = max(1, segment.windows // windows_per_block)
        blocks.append(first + np.arange(segment.windows) * count // segment.windows)
        first += count
    return np.concatenate(blocks)[runs.counted]


def _derivatives(
    search: Search, coordinates: Coordinates, motor: int, free: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """H (F, F) of one motor, and the gradients of its blocks (B, F), in the coordinates y.

    Differences are over ±WIDE, about the width of an interval of an identified constant.
    """
    points = [coordinates.x[motor]]
    widths = []
    for column in free:
        ends = []
        for change in (WIDE, -WIDE):
            moved, y_change = coordinates.moved(column, np.full(len(coordinates.x), change))
            point = coordinates.x[motor].copy()
            point[column] = moved[motor]
            points.append(point)
            ends.append(y_change[motor])
        widths.append(ends[0] - ends[1])

    residuals = search.problem.residuals(np.array(points), np.full(len(points), motor))
    residuals = residuals.astype(np.float64)
    middle = residuals[0]
    # a constant at the bound of its range may not move at all: it has no effect then
    distances = np.array(widths)[:, None]
    can_move = distances != 0.0
    differences = np.where(can_move, residuals[1::2] - residuals[2::2], 0.0)
    slopes = differences / np.where(can_move, distances, 1.0)
    usable = np.isfinite(slopes).all(axis=0) & (np.abs(slopes) < 1e6).all(axis=0)
    slopes = np.where(usable, slopes, 0.0)

    return curvature_and_scores(search.problem, middle, slopes, blocks)


def curvature_and_scores(
    problem: Problem, residuals: np.ndarray, slopes: np.ndarray, blocks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """H (F, F) of a motor, and the gradients g of its blocks (B, F).

    Args:
        problem: of the motor.
        residuals: (R,) at the motor.
        slopes: (F, R) derivatives of the residuals with respect to F unknowns.
        blocks: (N,) block of each observation, see `blocks_of`.
    """
    squares = 1.0 + residuals**2
    factor = problem.weight / len(residuals)
    curvature = factor * (slopes * squares**-1.5) @ slopes.T
    gradients = factor * slopes * (residuals / np.sqrt(squares))
    by_window = gradients.reshape(len(slopes), problem.observations, -1).sum(axis=2)
    scores = np.zeros((blocks.max() + 1, len(slopes)))
    np.add.at(scores, blocks, by_window.T)
    return curvature, scores
