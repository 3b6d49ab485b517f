"""Positions and velocities of a log without the noise of its readings, for the initial states of free runs.

A Kalman filter and the Rauch-Tung-Striebel smoother, with the joint's acceleration as a random
walk,

    x = (q, dq, ddq),   x' = F·x + w,   w ~ N(0, d²·Q(dt)),   reading = q + n,   n ~ N(0, r²)

per motor, forwards and backwards over each segment. Noise r and density d [rad/s²/√s] of the random
walk maximise the likelihood on a grid; r is at least an encoder's step/√12, since a static joint
repeats its reading and seems free of noise. With r below MIN_NOISE the log stays as it is. Recorded
velocities, often filtered differences of the same readings, are not used.
"""

import numpy as np

from motorprior.compiled import njit
from motorprior.signals import encoder_step

MIN_NOISE = 4e-5  # standard deviation of a reading below which a log counts as free of noise [rad]
NOISES = np.geomspace(1e-5, 3e-3, 11)  # r that are tried [rad]
DENSITIES = np.geomspace(1.0, 3e4, 10)  # d that are tried [rad/s²/√s]
# initial standard deviations: velocity _WIDE/10 [rad/s], acceleration 100·_WIDE [rad/s²]
_WIDE = 1e2
# used to choose noise and density
_MAX_ROWS = 2000
_MAX_MOTORS = 6
# rows that are tried together; rows until the filter has converged
_BLOCK = 500
_FIRST_STATES = 10


@njit(cache=True, nogil=True)
def _filter(readings, dt, noise, density):
    """Kalman filter of (steps,) readings: log-likelihood, and means and covariances after and before each reading."""
    steps = readings.shape[0]
    means = np.empty((steps, 3))
    predicted = np.empty((steps, 3))
    covariances = np.empty((steps, 3, 3))
    predicted_covariances = np.empty((steps, 3, 3))
    r = noise * noise
    d = density * density
    x = np.array([readings[0], 0.0, 0.0])
    cov = np.diag(np.array([r, _WIDE**2 * 1e-2, _WIDE**4]))
    move = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    extra = d * np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    likelihood = 0.0
    for step in range(steps):
        if step > 0:
            x = move @ x
            cov = move @ cov @ move.T + extra
        predicted[step] = x
        predicted_covariances[step] = cov
        variance = cov[0, 0] + r
        innovation = readings[step] - x[0]
        gain = cov[:, 0] / variance
        if step > _FIRST_STATES:
            likelihood -= 0.5 * (innovation * innovation / variance + np.log(variance))
        x = x + gain * innovation
        cov = cov - np.outer(gain, cov[0])
        means[step] = x
        covariances[step] = cov
    return likelihood, means, covariances, predicted, predicted_covariances


@njit(cache=True, nogil=True)
def _smooth(readings, dt, noise, density):
    """Smoothed positions and velocities (2, steps) of (steps,) readings."""
    steps = readings.shape[0]
    out = np.empty((2, steps))
    _, means, covariances, predicted, predicted_covariances = _filter(readings, dt, noise, density)
    move = np.array([[1.0, dt, 0.5 * dt * dt], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    x = means[steps - 1].copy()
    out[0, steps - 1] = x[0]
    out[1, steps - 1] = x[1]
    for back in range(steps - 2, -1, -1):
        gain = covariances[back] @ move.T @ np.linalg.inv(predicted_covariances[back + 1])
        x = means[back] + gain @ (x - predicted[back + 1])
        out[0, back] = x[0]
        out[1, back] = x[1]
    return out


def noise_of(readings: np.ndarray, parts: tuple[slice, ...], dt: float) -> tuple[float, float]:
    """Most likely noise r [rad] of one motor's (R,) readings, and density d of its motion; see `smoothed`."""
    likelihood = np.zeros((len(NOISES), len(DENSITIES)))
    for block in _blocks(readings, parts):
        rows = np.ascontiguousarray(readings[block], np.float64)
        likelihood += [
            [_filter(rows, dt, noise, density)[0] for density in DENSITIES] for noise in NOISES
        ]
    rounding = encoder_step(readings) / np.sqrt(12.0)
    first = min(int(np.searchsorted(NOISES, rounding)), len(NOISES) - 1)
    best = np.unravel_index(likelihood[first:].argmax(), likelihood[first:].shape)
    return max(float(NOISES[first + best[0]]), rounding), float(DENSITIES[best[1]])


def _blocks(readings: np.ndarray, parts: tuple[slice, ...]) -> list[slice]:
    # half where the motor moves fastest, half spread over its log: in slow or steady motion any
    # density fits
    starts = [
        (first, part.stop) for part in parts for first in range(part.start, part.stop, _BLOCK)
    ]
    cut = [
        slice(first, min(first + _BLOCK, stop))
        for first, stop in starts
        if stop - first > 2 * _FIRST_STATES
    ]
    if not cut:
        return []
    count = min(
        len(cut),
        max(2, round(_MAX_ROWS * len(cut) / sum(block.stop - block.start for block in cut))),
    )
    steps = [np.std(np.diff(readings[block])) for block in cut]
    fastest = np.argsort(steps, kind="stable")[::-1][: (count + 1) // 2]
    others = np.setdiff1d(np.arange(len(cut)), fastest)
    spread = others[np.linspace(0, len(others) - 1, count - len(fastest)).round().astype(int)]
    return [cut[each] for each in sorted({*fastest.tolist(), *spread.tolist()})]


def smoothing_of(
    readings: np.ndarray, parts: tuple[slice, ...], dt: float
) -> tuple[float, float] | None:
    """Noise r [rad] and density d [rad/s²/√s] for `smoothed`, of (R, M) readings [rad]; None if free of noise.

    They are the medians over some motors that move. ``parts`` are the rows of each segment, ``dt``
    [s].
    """
    moving = np.flatnonzero(np.ptp(readings, axis=0))  # a static one does not identify the noise
    if moving.size == 0:
        return None
    some = moving[
        np.unique(np.linspace(0, len(moving) - 1, min(_MAX_MOTORS, len(moving))).astype(int))
    ]
    noise, density = np.median([noise_of(readings[:, motor], parts, dt) for motor in some], axis=0)
    return None if noise < MIN_NOISE else (float(noise), float(density))


def smoothed(
    readings: np.ndarray, parts: tuple[slice, ...], dt: float, noise: float, density: float
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [rad] and velocities [rad/s], each (R, M), of (R, M) readings [rad].

    For readings at other steps, the same smoothing has the noise r·√(dt/dt'): r²·dt is its power
    density.
    """
    out = np.empty((2, *readings.shape))
    for motor, column in enumerate(readings.T):
        for part in parts:
            out[:, part, motor] = _smooth(
                np.ascontiguousarray(column[part], np.float64), dt, noise, density
            )
    return out[0], out[1]
