"""Commands of the past: one row of a memory per physics step, oldest overwritten first."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always")
def delayed_target(memory: np.ndarray, first: int, now: int, lag: float, motor: int) -> float:
    """Position target [rad] of ``lag`` steps ago, linear between steps.

    Args:
        memory: (rows, n); from row ``first`` on it is the line, written at ``first + step % its length``.
        first: rows of other state before the line.
        now: step whose target was written last.
        lag: not negative, at most two steps less than the line is long.
        motor: column.
    """
    ring, whole = memory.shape[0] - first, int(lag)
    newer, older = memory[first + (now - whole) % ring, motor], memory[first + (now - whole - 1) % ring, motor]
    return newer + (lag - whole) * (older - newer)
