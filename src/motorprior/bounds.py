"""Numbers and arrays that come from outside, checked before anything computes with them or is written.

Compiled code would read beyond a short array, and compute with NaN.
"""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np

from motorprior.exceptions import ConfigError, spelled

LARGEST = 1e300
LARGEST_SEED = 2**31 - 1


def is_number(value: Any, least: float = -LARGEST, most: float = LARGEST) -> bool:
    """Whether it is a real number, no truth value, in [least, most]; NaN is in no interval."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    number: Any = value  # compared as it is: an integer may be too long for a float
    return bool(least <= number <= most)


def is_range(value: Any, least: float, most: float) -> bool:
    """Whether it is a pair of numbers in [least, most], the smaller first."""
    pair = isinstance(value, tuple) and len(value) == 2
    return pair and all(is_number(each, least, most) for each in value) and value[0] <= value[1]


def require_number(name: str, value: Any, least: float = 0.0, most: float = LARGEST) -> None:
    """Refuse what is no number in [least, most], or not finite.

    Args:
        name: of the argument, dotted where it is one of another one's.
        value: its value.
        least: smallest value allowed.
        most: largest value allowed.

    Raises:
        ConfigError: names the argument, its value and the bounds.
    """
    if not is_number(value, least, most):
        _refuse(name, value, "finite number", f"{least:g}", f"{most:g}" if most < LARGEST else None)


def require_count(name: str, value: Any, least: int = 1, most: int | None = None) -> None:
    """Refuse what is no whole number in [least, most].

    Raises:
        ConfigError: names the argument, its value and the bounds.
    """
    if not (isinstance(value, Integral) and is_number(value, least, LARGEST if most is None else most)):
        _refuse(name, value, "whole number", str(least), None if most is None else str(most))


def require_seed(seed: Any) -> None:
    """Refuse a seed that a random number generator does not take.

    Raises:
        ConfigError: no whole number, below 0, or beyond 31 bits.
    """
    require_count("seed", seed, 0, LARGEST_SEED)


def generator_of(seed: int | np.random.Generator) -> np.random.Generator:
    """The generator itself, which goes on from where it is, or a new one with that seed.

    Raises:
        ConfigError: neither a generator nor a seed; see `require_seed`.
    """
    if isinstance(seed, np.random.Generator):
        return seed
    require_seed(seed)
    return np.random.default_rng(seed)


def seed_of(*words: int) -> int:
    """A seed of 32 bits that depends on all of some whole numbers, such as a stream's tag, a seed and a count."""
    return int(np.random.SeedSequence(words).generate_state(1, np.uint32)[0])


def _refuse(name: str, value: Any, kind: str, least: str, most: str | None) -> None:
    bounds = f"a {kind} of at least {least}" if most is None else f"a {kind} from {least} to {most}"
    raise ConfigError(f"{name} {spelled(value)} is not {bounds}", remedy=f"give {bounds}", argument=name)


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
