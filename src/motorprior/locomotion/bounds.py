"""Numbers and arrays that come from outside: compiled code would read beyond a short array, and compute with NaN."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

from motorprior.exceptions import ConfigError

LARGEST = 1e300


def is_number(value: Any, least: float = -LARGEST, most: float = LARGEST) -> bool:
    """Whether it is a real number, no truth value, in [least, most]; NaN is in no interval."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    number: Any = value  # compared as it is: an integer may be too long for a float
    return bool(least <= number <= most)


def require_number(name: str, value: Any, least: float = 0.0) -> None:
    """Refuse what is no number of at least ``least``, or not finite.

    Raises:
        ConfigError: names it, its value and the bound.
    """
    if not is_number(value, least):
        bound = f"a finite number of at least {least:g}"
        raise ConfigError(f"{name} {value!r} is not {bound}", remedy=f"give {bound}")


def require_count(name: str, value: Any, least: int = 1) -> None:
    """Refuse what is no whole number of at least ``least``.

    Raises:
        ConfigError: names it, its value and the bound.
    """
    if not (isinstance(value, Integral) and is_number(value, least)):
        bound = f"a whole number of at least {least}"
        raise ConfigError(f"{name} {value!r} is not {bound}", remedy=f"give {bound}")


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
