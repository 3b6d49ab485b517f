"""Rows in which a joint is not driven by its motor alone: an entry per cause.

All masks depend on commands and angles only, in units of the motion, not on errors of a fit.
"""

import numpy as np

from motorprior.identification import windows as channel
from motorprior.identification.explanations.explanation import RowExplanation

_AT_EXTREME = 0.02  # distance from the extreme angle, over the range of the angle
_BEYOND = 0.02  # distance of a command beyond it, over the range of the angle
_STOP_SECONDS = 0.05  # shortest contact with an end stop
_SPAN_SECONDS = 1.0  # span in which a joint must respond
# range of the command in this span: over its range in the log, and over the median error of the
# joint, since dead zone and dry friction hold a joint in small motions
_MIN_COMMAND = 0.15
_MIN_ERRORS = 3.0
_MIN_RESPONSE = 0.12  # range of the angle over the range of the command in this span
_MARGIN_SECONDS = 1.0  # left out before and after rows without response
# neighbouring rows are left out as well while errors, at most this time apart, are among the
# largest of the other rows: this share of them
_GAP_SECONDS = 0.1
_LARGE_SHARE = 0.05


def _end_stop(rows: np.ndarray, motion: np.ndarray, period: float) -> np.ndarray:
    """Angle at its extreme, and command beyond it."""
    angle = rows[:, channel.POS]
    target = rows[:, channel.TARGET]
    low, high = np.quantile(angle, [0.001, 0.999], axis=0)
    size = np.maximum(high - low, 1e-9)
    is_above = (angle > high - _AT_EXTREME * size) & (target > high + _BEYOND * size)
    is_below = (angle < low + _AT_EXTREME * size) & (target < low - _BEYOND * size)
    count = max(1, round(_STOP_SECONDS / period))
    return _sustained(is_above, count) | _sustained(is_below, count)


def _no_response(rows: np.ndarray, motion: np.ndarray, period: float) -> np.ndarray:
    """The command moves and the angle does not."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # here: half a second to import

    count = max(3, round(_SPAN_SECONDS / period))

    def spans(values: np.ndarray) -> np.ndarray:
        return maximum_filter1d(values, count, axis=0) - minimum_filter1d(values, count, axis=0)

    target = rows[:, channel.TARGET]
    command = spans(target)
    median_error = np.median(np.abs(target - rows[:, channel.POS]), axis=0)
    min_command = np.maximum(_MIN_COMMAND * np.ptp(target, axis=0), _MIN_ERRORS * median_error)
    moves = command > np.maximum(min_command, 1e-9)
    is_dead = moves & (spans(rows[:, channel.POS]) < _MIN_RESPONSE * command)
    margin = 2 * round(_MARGIN_SECONDS / period) + 1
    # rows between two dead ones are dead as well
    near = maximum_filter1d(is_dead.astype(float), 2 * margin + 1, axis=0) > 0.0

    # a joint that falls when its torque goes off moves at first: errors are large from there on
    error = np.abs(target - rows[:, channel.POS])
    is_large = np.zeros_like(near)
    for joint in np.flatnonzero(near.any(axis=0) & ~near.all(axis=0)):
        usual = error[~near[:, joint], joint]
        is_large[:, joint] = error[:, joint] > np.quantile(usual, 1.0 - _LARGE_SHARE)
    gap = 2 * round(_GAP_SECONDS / period) + 1
    return _grown(near, maximum_filter1d(is_large.astype(float), gap, axis=0) > 0.0)


def _grown(mask: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """The mask (T, M), with the runs of ``neighbours`` (T, M) that touch it."""
    from scipy.ndimage import binary_propagation  # here: half a second to import

    along_time = np.array([[False, True, False]] * 3)
    return binary_propagation(mask, along_time, mask=mask | neighbours)


def _sustained(mask: np.ndarray, count: int) -> np.ndarray:
    """The mask (T, M) without runs of fewer than ``count`` rows."""
    from scipy.ndimage import binary_opening  # here: half a second to import

    return binary_opening(mask, np.ones((count, 1), bool))


ROW_EXPLANATIONS = (
    RowExplanation(
        "end_stop",
        _end_stop,
        "stays at its extreme angle for {seconds:.3g} s in total while its command continues",
        "an end stop: delete these rows, or command less",
    ),
    RowExplanation(
        "no_response",
        _no_response,
        "does not follow its command in {seconds:.3g} s of the log, {where}",
        "torque off, or the joint was held: delete these rows",
    ),
)
