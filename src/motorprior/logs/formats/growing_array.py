"""An array whose rows arrive in batches."""

from __future__ import annotations

import numpy as np


class GrowingArray:
    """Batches one after another in one array that grows in place.

    A list of batches and their concatenation would both be in memory at the end, and what the list leaves is in pieces.

    Args:
        first: the first batch, (rows,) or (rows, columns); all others have its type and its columns.
    """

    def __init__(self, first: np.ndarray):
        self._rows, self._array = len(first), np.array(first, order="C")

    def add(self, batch: np.ndarray) -> None:
        """Put a batch after the last one."""
        stop = self._rows + len(batch)
        if stop > len(self._array):
            self._array.resize((2 * stop, *self._array.shape[1:]), refcheck=False)
        self._array[self._rows : stop] = batch
        self._rows = stop

    def finished(self) -> np.ndarray:
        """All rows; no more can be added."""
        self._array.resize((self._rows, *self._array.shape[1:]), refcheck=False)
        return self._array
