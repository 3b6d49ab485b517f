"""Ground that is not flat: gentle random bumps, level where the robot starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from motorprior.exceptions import ConfigError

HIGHEST = 0.05
"""Largest roughness [m]; the robot stands 0.17 m high."""
CELL, EXTENT = 0.04, 8.0
"""Distance between neighbouring heights, and edge of the patch [m]."""
WAVELENGTH = 0.2
"""Of the shortest bumps [m], four standard deviations of the Gaussian that smooths them."""
START_RADIUS = 0.25
"""Radius of the level ground around the origin [m]."""
BLEND = 0.25
"""Width over which the bumps grow from level ground to their full height [m]."""
_STREAM = 0x7E44


@dataclass(frozen=True)
class Terrain:
    """A square patch of ground about the origin.

    Attributes:
        roughness: highest bump above the lowest [m]; 0 is an endless flat floor.
    """

    roughness: float = 0.0

    def __post_init__(self) -> None:
        """Refuse cliffs."""
        if not 0.0 <= self.roughness <= HIGHEST:
            raise ConfigError(
                f"roughness {self.roughness} m is not in 0..{HIGHEST} m",
                remedy="give a height the robot can step on",
                argument="roughness",
            )


def heights(terrain: Terrain, seed: int) -> np.ndarray:
    """(n, n) heights [m], y by x, zero around the origin; white noise, smoothed, scaled to the roughness."""
    count = round(EXTENT / CELL) + 1
    noise = np.random.default_rng([_STREAM, seed]).standard_normal((count, count))
    field = gaussian_filter(noise, 0.25 * WAVELENGTH / CELL)
    field *= terrain.roughness / np.ptp(field)
    line = CELL * (np.arange(count) - (count - 1) / 2)
    apart = np.hypot(*np.meshgrid(line, line))
    return field * np.clip((apart - START_RADIUS) / BLEND, 0.0, 1.0)
