"""Checks of arguments; compiled code would read beyond a short array and compute with NaN."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

from motorprior.exceptions import ConfigError, quoted

MAX_NUMBER = 1e300
MAX_SEED = 2**31 - 1


def is_number(value: Any, minimum: float = -MAX_NUMBER, maximum: float = MAX_NUMBER) -> bool:
    """Whether a value is a real number, not a bool, in [minimum, maximum]; False for NaN."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    number: Any = value  # not converted: an integer may be too large for a float
    return bool(minimum <= number <= maximum)


def is_range(value: Any, minimum: float, maximum: float) -> bool:
    """Whether a value is a pair (low, high) of numbers in [minimum, maximum], low <= high."""
    pair = isinstance(value, tuple) and len(value) == 2
    return pair and all(is_number(each, minimum, maximum) for each in value) and value[0] <= value[1]


def require_number(
    name: str, value: Any, minimum: float = 0.0, maximum: float = MAX_NUMBER, positive: bool = False
) -> None:
    """Check the argument ``name``.

    Raises:
        ConfigError: not a finite number in [minimum, maximum], or not above 0 where it must be ``positive``.
    """
    if not is_number(value, minimum, maximum) or (positive and value <= 0.0):
        low = "0 (excluded)" if positive else f"{minimum:g}"
        _reject(name, value, "finite number", low, f"{maximum:g}" if maximum < MAX_NUMBER else None)


def require_count(name: str, value: Any, minimum: int = 1, maximum: int | None = None) -> None:
    """Check the argument ``name``.

    Raises:
        ConfigError: not a whole number in [minimum, maximum].
    """
    if not (isinstance(value, Integral) and is_number(value, minimum, MAX_NUMBER if maximum is None else maximum)):
        _reject(name, value, "whole number", str(minimum), None if maximum is None else str(maximum))


def _reject(name: str, value: Any, kind: str, minimum: str, maximum: str | None) -> None:
    bounds = f"a {kind} of at least {minimum}" if maximum is None else f"a {kind} from {minimum} to {maximum}"
    raise ConfigError(f"{name} {quoted(value)} is not {bounds}", remedy=f"give {bounds}", argument=name)


def require_seed(seed: Any) -> None:
    """Check a seed.

    Raises:
        ConfigError: not a whole number from 0 to 2³¹ - 1.
    """
    require_count("seed", seed, 0, MAX_SEED)


def generator_of(seed: int | np.random.Generator) -> np.random.Generator:
    """A new generator with this seed, or the given generator itself.

    Raises:
        ConfigError: see `require_seed`.
    """
    if isinstance(seed, np.random.Generator):
        return seed
    require_seed(seed)
    return np.random.default_rng(seed)


def seed_of(*words: int) -> int:
    """A seed of 32 bits, the hash of whole numbers such as a stream's tag, a seed and a count."""
    return int(np.random.SeedSequence(words).generate_state(1, np.uint32)[0])


def require_finite(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """``value`` as a C-contiguous float64 array.

    Raises:
        ConfigError: not numbers, another shape, or a number that is not finite.
    """
    remedy = f"give finite numbers of shape {shape}"
    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} is not an array of numbers", remedy=remedy) from error
    if np.shape(value) != shape:
        raise ConfigError(f"{name} has shape {np.shape(value)}, wanted {shape}", remedy=remedy)
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ConfigError(f"{name}{where} is not finite: {array[tuple(where)]}", remedy=remedy)
    return array
