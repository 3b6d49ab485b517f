"""Rough ground: smooth random bumps, level where the robot starts."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

CELL, EXTENT = 0.04, 8.0  # [m] distance between neighbouring heights, edge of the square patch about the origin
WAVELENGTH = 0.2  # [m] of the shortest bumps, four standard deviations of the smoothing Gaussian
START_RADIUS = 0.25  # [m] of the level ground around the origin
BLEND = 0.25  # [m] over which the bumps grow to their full height
_STREAM = 0x7E44


def heights(roughness: float, seed: int) -> np.ndarray:
    """(n, n) heights [m], y by x, zero around the origin; smoothed white noise, scaled to the peak-to-peak height."""
    count = round(EXTENT / CELL) + 1
    noise = np.random.default_rng([_STREAM, seed]).standard_normal((count, count))
    field = gaussian_filter(noise, 0.25 * WAVELENGTH / CELL)
    field *= roughness / np.ptp(field)
    line = CELL * (np.arange(count) - (count - 1) / 2)
    distance = np.hypot(*np.meshgrid(line, line))
    return field * np.clip((distance - START_RADIUS) / BLEND, 0.0, 1.0)
