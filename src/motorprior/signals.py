"""RMS, RMSE, runs of a mask, encoder step, means of held commands, high-frequency content."""

import numpy as np


def rms(values: np.ndarray, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Root mean square over ``axis`` (all axes by default)."""
    return np.sqrt(np.mean(np.square(values), axis=axis))


def rmse(a: np.ndarray, b: np.ndarray, axis: int | tuple[int, ...] | None = None) -> np.ndarray:
    """Root mean square of ``a - b`` over ``axis`` (all axes by default)."""
    return rms(np.asarray(a) - np.asarray(b), axis)


def runs_of_true(mask: np.ndarray) -> np.ndarray:
    """(R, 2) first index of each run of True in a mask (T,), and the index after the run."""
    padded = np.concatenate([[False], mask, [False]]).astype(int)
    changes = np.flatnonzero(np.diff(padded))
    return changes.reshape(-1, 2)


def encoder_step(readings: np.ndarray) -> float:
    """Smallest difference [rad] above 1e-6 between two readings (T,); 0 if there is none."""
    steps = np.diff(np.unique(readings))
    steps = steps[steps > 1e-6]  # below this is rounding
    return float(steps.min()) if steps.size else 0.0


def mean_command(
    time: np.ndarray, command: np.ndarray, grid: np.ndarray, period: float
) -> np.ndarray:
    """(G, J) mean command in the period that begins at each time of the grid (G,).

    Commands (T, J) are held from their ``time`` (T,) until the next one.
    """
    return mean_between(time, command, np.append(grid, grid[-1] + period), period)


def mean_between(
    time: np.ndarray, command: np.ndarray, edges: np.ndarray, durations: np.ndarray | float
) -> np.ndarray:
    """(G, J) mean command between successive ``edges`` (G + 1,), which are ``durations`` apart.

    Commands (T, J) are held from their ``time`` (T,) until the next one; the first precedes all
    edges. The durations (G,) may be one number.
    """
    tolerance = 1e-6 * float(np.min(durations))
    row = np.searchsorted(time, edges + tolerance, side="right") - 1

    # integral of the command from the first time to each edge
    steps = command[:-1] * np.diff(time)[:, None]
    area_at_rows = np.concatenate([np.zeros((1, command.shape[1])), np.cumsum(steps, axis=0)])
    area = area_at_rows[row] + command[row] * (edges - time[row])[:, None]

    # a command that is in force all the time is exact, without the rounding of the integral
    row_at_end = np.searchsorted(time, edges[1:] - tolerance, side="right") - 1
    is_constant = (row[:-1] == row_at_end)[:, None]
    mean = np.diff(area, axis=0) / np.reshape(durations, (-1, 1))
    return np.where(is_constant, command[row[:-1]], mean)
