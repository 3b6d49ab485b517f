"""What compiled code would not notice: it reads beyond a short array, and computes with NaN."""

from __future__ import annotations

from typing import Any

import numpy as np

from motorprior.exceptions import ConfigError


def require_finite(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """``value`` as a C-contiguous float64 array.

    Raises:
        ConfigError: no numbers, another shape, or a number that is not finite.
    """
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} is not an array of numbers", remedy=f"give one of shape {shape}") from error
    if np.shape(value) != shape:
        raise ConfigError(f"{name} has shape {np.shape(value)}, wanted {shape}", remedy=f"give one of shape {shape}")
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ConfigError(f"{name}{where} is not finite: {array[tuple(where)]}", remedy="give finite numbers")
    return array
