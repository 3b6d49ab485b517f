"""Delay line: a ring buffer with one row per step, in a memory (rows, n) from row ``first`` on.

Its length must be at least 1 + the maximum age for `row_of_age`, and 2 + the whole steps of the
maximum age for `interpolated` and `held`.
"""

import math

import numpy as np

from motorprior.compiled import njit


@njit(cache=True, nogil=True)
def fill_line(memory: np.ndarray, first: int, values: np.ndarray) -> None:
    """Set every row of the line to the values (n,)."""
    for row in range(first, memory.shape[0]):
        memory[row, :] = values


@njit(cache=True, nogil=True, inline="always")
def write_line(memory: np.ndarray, first: int, now: int, values: np.ndarray) -> int:
    """Write the values (n,) of step number ``now``; returns their index in the line."""
    newest = now % (memory.shape[0] - first)
    for column in range(values.shape[0]):
        memory[first + newest, column] = values[column]
    return newest


@njit(cache=True, nogil=True, inline="always")
def row_of_age(memory: np.ndarray, first: int, newest: int, age: int) -> int:
    """Row of the memory that was written ``age`` steps before the ``newest``."""
    length = memory.shape[0] - first  # a division by the length takes longer than the comparison
    return first + (newest - age if newest >= age else newest - age + length)


@njit(cache=True, nogil=True, inline="always")
def interpolated(memory: np.ndarray, first: int, newest: int, age: float, column: int) -> float:
    """The value ``age`` >= 0 steps ago, interpolated linearly between two steps."""
    whole_steps = int(age)
    newer = memory[row_of_age(memory, first, newest, whole_steps), column]
    older = memory[row_of_age(memory, first, newest, whole_steps + 1), column]
    return newer + (age - whole_steps) * (older - newer)


@njit(cache=True, nogil=True, inline="always")
def held(memory: np.ndarray, first: int, newest: int, age: float, column: int) -> float:
    """The last value written at least ``age`` steps ago, the newest for a negative age."""
    whole_steps = max(0, math.ceil(age - 1e-9))
    return memory[row_of_age(memory, first, newest, whole_steps), column]
