"""Positions and velocities without the noise of readings, for the initial states of free runs.

A Kalman filter and the Rauch-Tung-Striebel smoother, with the joint's acceleration as a random
walk,

    x = (q, dq, ddq),   x' = F·x + w,   w ~ N(0, d²·Q(dt)),   reading = q + n,   n ~ N(0, r²)

run for each motor, forwards and backwards over each segment. The noise r and the jerk density d
[rad/s²/√s] of the random walk maximise the likelihood on a grid. r is at least an encoder's
step/√12, since a static joint repeats its reading and seems free of noise. With r below MIN_NOISE
the log stays as it is. Recorded velocities are not used: they are often filtered differences of the
same readings.
"""

import numpy as np

from motorprior.compiled import njit
from motorprior.signals import encoder_step

MIN_NOISE = 4e-5  # standard deviation of a reading below which a log counts as free of noise [rad]
NOISES = np.geomspace(1e-5, 3e-3, 11)  # values of the noise r on the grid [rad]
JERK_DENSITIES = np.geomspace(1.0, 3e4, 10)  # values of the jerk density d on the grid [rad/s²/√s]
# initial standard deviations: velocity _WIDE/10 [rad/s], acceleration 100·_WIDE [rad/s²]
_WIDE = 1e2
# maximum number of rows, and of motors, from which noise and jerk density are estimated
_MAX_ROWS = 2000
_MAX_MOTORS = 6
_BLOCK = 500  # rows of a block, see `_blocks`
_FIRST_STATES = 10  # rows until the filter has converged


@njit(cache=True, nogil=True)
def _filter(readings, dt, noise, jerk_density):
    """Kalman filter of (steps,) readings.

    Returns the log-likelihood, means and covariances after each reading, and means and covariances
    before each reading.
    """
    steps = readings.shape[0]
    means = np.empty((steps, 3))
    predicted = np.empty((steps, 3))
    covariances = np.empty((steps, 3, 3))
    predicted_covariances = np.empty((steps, 3, 3))

    r = noise * noise
    d = jerk_density * jerk_density
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
def _smooth(readings, dt, noise, jerk_density):
    """Smoothed positions and velocities (2, steps) of (steps,) readings."""
    steps = readings.shape[0]
    out = np.empty((2, steps))
    _, means, covariances, predicted, predicted_covariances = _filter(
        readings, dt, noise, jerk_density
    )

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


def noise_of(readings: np.ndarray, segments: tuple[slice, ...], dt: float) -> tuple[float, float]:
    """Most likely noise r [rad] of one motor's (R,) readings, and jerk density d of its motion."""
    likelihood = np.zeros((len(NOISES), len(JERK_DENSITIES)))
    for block in _blocks(readings, segments):
        rows = np.ascontiguousarray(readings[block], np.float64)
        for row, noise in enumerate(NOISES):
            for column, jerk_density in enumerate(JERK_DENSITIES):
                likelihood[row, column] += _filter(rows, dt, noise, jerk_density)[0]

    rounding = encoder_step(readings) / np.sqrt(12.0)
    first = min(int(np.searchsorted(NOISES, rounding)), len(NOISES) - 1)
    allowed = likelihood[first:]  # noises of at least the rounding of the encoder
    row, column = np.unravel_index(allowed.argmax(), allowed.shape)
    noise = max(float(NOISES[first + row]), rounding)
    return noise, float(JERK_DENSITIES[column])


def _blocks(readings: np.ndarray, segments: tuple[slice, ...]) -> list[slice]:
    """Blocks of up to _BLOCK rows; all blocks together have about _MAX_ROWS rows.

    Half of the blocks are those in which the motor moves fastest, because in slow or steady motion
    any jerk density fits. The other half are spread over the log.
    """
    blocks = []
    for segment in segments:
        for start in range(segment.start, segment.stop, _BLOCK):
            stop = min(start + _BLOCK, segment.stop)
            if stop - start > 2 * _FIRST_STATES:
                blocks.append(slice(start, stop))
    if not blocks:
        return []

    num_rows = sum(block.stop - block.start for block in blocks)
    count = min(len(blocks), max(2, round(_MAX_ROWS * len(blocks) / num_rows)))

    steps = [np.std(np.diff(readings[block])) for block in blocks]
    fastest = np.argsort(steps, kind="stable")[::-1][: (count + 1) // 2]
    slower = np.setdiff1d(np.arange(len(blocks)), fastest)
    places = np.linspace(0, len(slower) - 1, count - len(fastest)).round().astype(int)
    indices = sorted({*fastest.tolist(), *slower[places].tolist()})
    return [blocks[index] for index in indices]


def smoothing_of(
    readings: np.ndarray, segments: tuple[slice, ...], dt: float
) -> tuple[float, float] | None:
    """Noise r [rad] and jerk density d [rad/s²/√s] for `smoothed`, of (R, M) readings [rad].

    Both are medians over up to 6 motors that move; None if the readings are free of noise.
    ``segments`` are the rows of each segment, ``dt`` is the time between two rows [s].
    """
    # static motors do not identify the noise
    moving = np.flatnonzero(np.ptp(readings, axis=0))
    if moving.size == 0:
        return None
    places = np.linspace(0, len(moving) - 1, min(_MAX_MOTORS, len(moving))).astype(int)
    motors = moving[np.unique(places)]
    estimates = [noise_of(readings[:, motor], segments, dt) for motor in motors]
    noise, jerk_density = np.median(estimates, axis=0)
    return None if noise < MIN_NOISE else (float(noise), float(jerk_density))


def smoothed(
    readings: np.ndarray, segments: tuple[slice, ...], dt: float, noise: float, jerk_density: float
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [rad] and velocities [rad/s], each (R, M), of (R, M) readings [rad].

    ``noise`` r is in rad, ``jerk_density`` d in rad/s²/√s. The noise has the power density r²·dt:
    for readings at steps dt' in place of dt, the noise r·√(dt/dt') gives the same smoothing.
    """
    states = np.empty((2, *readings.shape))
    for motor, column in enumerate(readings.T):
        for segment in segments:
            rows = np.ascontiguousarray(column[segment], np.float64)
            states[:, segment, motor] = _smooth(rows, dt, noise, jerk_density)
    return states[0], states[1]
