"""Turns of a motion."""

from __future__ import annotations

import numpy as np


def reversals(angle: np.ndarray, least: float | None = None) -> list[int]:
    """Rows at which an angle (T,), in time order, turns to go back by ``least`` [rad], by default 5 % of its range."""
    least = 0.05 * float(np.ptp(angle)) if least is None else least
    if least <= 0.0:
        return []
    low = high = float(angle[0])
    low_row = high_row = 0
    direction, found = 0, []
    for row, value in enumerate(angle.tolist()):
        if value > high:
            high, high_row = value, row
        if value < low:
            low, low_row = value, row
        if direction >= 0 and value < high - least:
            found += [high_row] if direction else []
            direction, low, low_row = -1, value, row
        elif direction <= 0 and value > low + least:
            found += [low_row] if direction else []
            direction, high, high_row = 1, value, row
    return found
