"""Commands of the past: one row of a memory per physics step, oldest overwritten first."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always")
def delayed_target(memory: np.ndarray, first: int, newest: int, lag: float, motor: int) -> float:
    """Position target [rad] of ``lag`` steps ago, linear between steps.

    Args:
        memory: (rows, n); from row ``first`` on it is the line, written at ``first + step % its length``.
        first: rows of other state before the line.
        newest: place in the line that was written last.
        lag: not negative, at most two steps less than the line is long.
        motor: column.
    """
    ring, whole = memory.shape[0] - first, int(lag)
    place = newest - whole if newest >= whole else newest - whole + ring  # a division by the length takes longer
    before = place - 1 if place > 0 else ring - 1
    newer, older = memory[first + place, motor], memory[first + before, motor]
    return newer + (lag - whole) * (older - newer)
