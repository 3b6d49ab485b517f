"""Commands of the past: a ring of rows in a motor's memory, one per physics step, the oldest overwritten first.

The line is all rows of the memory (rows, n) from row ``first`` on; other state stands before it. Its length must be
at least two more than the longest age that is read.
"""

from __future__ import annotations

import numpy as np

from motorprior.compiled import njit


@njit(cache=True, nogil=True)
def fill_line(memory: np.ndarray, first: int, position_target: np.ndarray) -> None:
    """Set every row of the line to the targets (n,) [rad], as if they had always been given."""
    for row in range(first, memory.shape[0]):
        memory[row, :] = position_target


@njit(cache=True, nogil=True, inline="always")
def write_line(memory: np.ndarray, first: int, now: int, position_target: np.ndarray) -> int:
    """Write the targets (n,) [rad] of step number ``now``; returns their place in the line."""
    newest = now % (memory.shape[0] - first)
    for motor in range(position_target.shape[0]):
        memory[first + newest, motor] = position_target[motor]
    return newest


@njit(cache=True, nogil=True, inline="always")
def row_of_age(memory: np.ndarray, first: int, newest: int, age: int) -> int:
    """Row of the memory that was written ``age`` steps before the ``newest``."""
    length = memory.shape[0] - first  # a division by the length takes longer than the comparison
    return first + (newest - age if newest >= age else newest - age + length)


@njit(cache=True, nogil=True, inline="always")
def interpolated(memory: np.ndarray, first: int, newest: int, age: float, motor: int) -> float:
    """Position target [rad] of ``age`` >= 0 steps ago, linear between two steps."""
    whole = int(age)
    newer = memory[row_of_age(memory, first, newest, whole), motor]
    older = memory[row_of_age(memory, first, newest, whole + 1), motor]
    return newer + (age - whole) * (older - newer)
