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

A profile checks this linearisation. Each constant that seems identified is fixed at the ends of its
interval, and the other constants are fitted again. If the loss rises by less than the quadratic
approximation states, the standard deviation is scaled by the root of the ratio.
"""

from dataclasses import replace

import numpy as np

from motorprior.actuator.estimates import (
    LIMITS,
    SCORE,
    Estimates,
    coordinate,
    is_identified,
    value_at,
)
from motorprior.actuator.geared_motor_step import MAX_LOG_FACTOR, parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import SIGNED
from motorprior.identification import windows as channel
from motorprior.identification.physics.effect_scales import effect_scale
from motorprior.identification.physics.motor_problem import (
    WEAK_PRECISION,
    fixed_constants,
    motor_search,
)
from motorprior.identification.physics.window_runs import POSITION_SCALE, WindowRuns
from motorprior.identification.search import FIXED, NARROW, WIDE, GaussianPrior, Problem, Search
from motorprior.signals import rms

# Share by which the loss may rise within a 90 % interval. Chosen on simulated arms other than those
# of the reported coverage (benchmarks/simulated_arms.py).
MODEL_ERROR = 0.07
BLOCK = 1.0  # minimum duration of a block of a log [s]
UNKNOWN_STD = MAX_LOG_FACTOR  # of a constant that a log does not identify at all
MIN_EIGENVALUE = 1e-9  # of H, relative to its largest one: the accuracy of differences
_MIN_TORQUE = 1e-6  # on a joint without a load [N·m]
MAX_PROFILE_FACTOR = 10.0  # maximum factor of a profile on a standard deviation
_PROFILE_STEPS = ((6, WIDE), (4, NARROW))


def estimates_of(model: GreyBox, x: np.ndarray, runs: WindowRuns) -> Estimates:
    """Joint uncertainty of the constants of the motors x (M, K), fitted to the logs ``runs``.

    ``model`` has one latent per constant and no copula.
    """
    fixed = fixed_constants(model.terms, runs)
    search = motor_search(model, runs)
    hidden = hidden_by_errors(search, runs, x)
    coordinates = _Coordinates(model, runs, x, hidden)
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
    return _profiled(search, coordinates, estimates, free, losses)


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


class _Coordinates:
    """The map between unknowns x of the fit and coordinates y of M motors.

    Attributes:
        names: (K) names of the constants.
        x: (M, K) unknowns of the fit.
        scale: (M, K) scales s [SI], see `Estimates`.

    A constant has no effect below the value that the errors hide, (M,) in ``hidden`` by its name.
    """

    def __init__(
        self, model: GreyBox, runs: WindowRuns, x: np.ndarray, hidden: dict[str, np.ndarray]
    ):
        self.names = parameters_of(model.terms)
        self.x = x
        self._center = model.center
        self.scale = np.zeros_like(x)
        values = model.constants(x)
        for column, name in enumerate(self.names):
            scale = effect_scale(name, values, runs)
            self.scale[:, column] = np.maximum(scale, hidden.get(name, 0.0))

    def moved(self, column: int, y_change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns (M,) of a constant at y + y_change (M,), and the real change of y (M,).

        The change is smaller where it would leave the reach of the decoder.
        """
        name = self.names[column]
        y = self._y(name, self.x[:, column], column)
        value = value_at(name, y + y_change, self._scale_of(name, column))
        if name in SIGNED:
            moved = value / SIGNED[name] - self._center[column]
        else:
            with np.errstate(divide="ignore"):
                moved = np.log(value) - self._center[column]
        moved = np.clip(moved, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
        return moved, self._y(name, moved, column) - y

    def half_width(self, column: int, size: np.ndarray) -> np.ndarray:
        """(M,) widths to both sides in y that hold v ± ``size`` (M,) of a positive constant v.

        A width is the linear one, which reaches further upwards, or the exact one downwards if that
        is larger. For a gear stiffness, v and ``size`` are of the compliance.
        """
        # y = log(v + s)
        sum_of_both = np.exp(self._y(self.names[column], self.x[:, column], column))
        below = np.minimum(size, sum_of_both - self.scale[:, column])
        return np.maximum(size / sum_of_both, -np.log1p(-below / sum_of_both))

    def _y(self, name: str, x: np.ndarray, column: int) -> np.ndarray:
        raw = x + self._center[column]
        value = raw * SIGNED[name] if name in SIGNED else np.exp(raw)
        return coordinate(name, value, self._scale_of(name, column))

    def _scale_of(self, name: str, column: int) -> np.ndarray:
        return np.zeros(len(self.x)) if name in LIMITS else self.scale[:, column]


def _derivatives(
    search: Search, coordinates: _Coordinates, motor: int, free: np.ndarray, blocks: np.ndarray
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


def _profiled(
    search: Search,
    coordinates: _Coordinates,
    estimates: Estimates,
    free: np.ndarray,
    losses: np.ndarray,
) -> Estimates:
    """The estimates with larger standard deviations where a profile of the loss is flatter.

    ``free`` are the columns of the fitted constants, ``losses`` (M,) those of the fit.
    """
    factors = np.ones_like(coordinates.x)
    for column in free:
        seems_identified = _seems_identified(coordinates, estimates, column)
        motors = np.flatnonzero(seems_identified)
        if not len(motors):
            continue
        for sign in (1.0, -1.0):
            ratio = _profile_ratio(search, coordinates, estimates, column, sign, motors, losses)
            factor = np.clip(ratio**-0.5, 1.0, MAX_PROFILE_FACTOR)
            factors[motors, column] = np.maximum(factors[motors, column], factor)

    covariance = factors[:, :, None] * estimates.covariance * factors[:, None, :]
    return Estimates(covariance, estimates.scale)


def _seems_identified(coordinates: _Coordinates, estimates: Estimates, column: int) -> np.ndarray:
    """(M,) whether the marginal interval of a constant identifies it."""
    name = coordinates.names[column]
    scale = coordinates._scale_of(name, column)
    y = coordinates._y(name, coordinates.x[:, column], column)
    reach = SCORE * np.sqrt(estimates.covariance[:, column, column])
    ends = np.stack([value_at(name, y - reach, scale), value_at(name, y + reach, scale)])
    return is_identified(name, np.sort(ends, axis=0))


def _profile_ratio(
    search: Search,
    coordinates: _Coordinates,
    estimates: Estimates,
    column: int,
    sign: float,
    motors: np.ndarray,
    losses: np.ndarray,
) -> np.ndarray:
    """(m,) rise of the loss at an end of the interval, over the rise that identifies it.

    The constant of ``motors`` (m,) is fixed at the end of its interval; the other constants start
    where the joint covariance expects them and are fitted again.
    """
    std = np.sqrt(estimates.covariance[:, column, column])
    start = coordinates.x.copy()
    change = sign * SCORE * std
    start[:, column], real_change = coordinates.moved(column, change)
    for other in range(start.shape[1]):
        covariance = estimates.covariance[:, other, column]
        if other != column and covariance.any():
            expected = np.clip(covariance / std**2 * real_change, -1.0, 1.0)
            start[:, other], _ = coordinates.moved(other, expected)

    is_fixed = (np.diagonal(estimates.covariance, axis1=1, axis2=2) == 0.0).all(axis=0)
    is_fixed[column] = True
    refitted = _refitted_losses(search, start, is_fixed, motors)
    rise = np.maximum(refitted - losses[motors], 0.0)

    # the end of an interval that the decoder cannot reach is checked nearer by, or not at all
    share = (real_change[motors] / change[motors]) ** 2
    expected_rise = MODEL_ERROR * losses[motors] * share
    is_checked = expected_rise > 0.0
    ratio = np.where(is_checked, rise / np.where(is_checked, expected_rise, 1.0), 1.0)
    return np.maximum(ratio, MAX_PROFILE_FACTOR**-2)


def _refitted_losses(
    search: Search, start: np.ndarray, is_fixed: np.ndarray, motors: np.ndarray
) -> np.ndarray:
    """(m,) losses of ``motors`` (m,) after steps from ``start`` (M, K), with fixed unknowns."""
    precision = np.where(is_fixed, FIXED, WEAK_PRECISION)
    prior = GaussianPrior(start, np.broadcast_to(precision, start.shape))
    return search.descend(start[motors], prior, _PROFILE_STEPS, motors).loss


def profile_rises(
    model: GreyBox, z: np.ndarray, runs: WindowRuns, factor: float, motors: np.ndarray
) -> dict[str, np.ndarray]:
    """(2, m) relative rises of the loss if a fitted positive constant is changed, by its name.

    The constant of ``motors`` (m indices) is divided by ``factor``, or multiplied by it, and the
    others are fitted again. ``z`` (M, Z) are the latents of all motors and ``runs`` their logs.
    """
    x = model.decoder_latents(z)
    search = motor_search(replace(model, copula=None), runs)
    losses = search.losses(x)
    fixed = fixed_constants(model.terms, runs)
    rises = {}
    for column, name in enumerate(parameters_of(model.terms)):
        if fixed[column] or name in SIGNED:
            continue
        is_fixed = fixed | (np.arange(len(fixed)) == column)
        both = []
        for change in (-np.log(factor), np.log(factor)):
            start = x.copy()
            start[:, column] = np.clip(x[:, column] + change, -MAX_LOG_FACTOR, MAX_LOG_FACTOR)
            both.append(_refitted_losses(search, start, is_fixed, motors))
        rises[name] = np.stack(both) / losses[motors] - 1.0
    return rises
