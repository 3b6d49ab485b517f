"""Values that arguments and entries of files may have, and the error for a value out of bounds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import ArtifactError, ConfigError, quoted

MAX_NUMBER = 1e300
MAX_SEED = 2**31 - 1


@dataclass(frozen=True)
class Field:
    """Declaration of a value: ``accepts`` tests it, ``meaning`` completes "VALUE is not …"."""

    meaning: str
    accepts: Callable[[Any], bool]


def is_number(value: Any, minimum: float = -MAX_NUMBER, maximum: float = MAX_NUMBER) -> bool:
    """Whether a value is a real number, not a bool, in [minimum, maximum]; False for NaN."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    return bool(minimum <= value <= maximum)  # pyright: ignore[reportOperatorIssue]


def number(
    minimum: float = -MAX_NUMBER, maximum: float = MAX_NUMBER, above: float = -inf, unit: str = ""
) -> Field:
    """A finite number in [minimum, maximum] and above ``above``, not a bool."""
    meaning = f"a finite number{_range(minimum, maximum, above)} {unit}".rstrip()
    return Field(meaning, lambda value: is_number(value, minimum, maximum) and value > above)


def integer(minimum: int, maximum: float = MAX_NUMBER) -> Field:
    """An integer in [minimum, maximum], not a bool."""
    meaning = f"an integer{_range(minimum, maximum, -inf)}"
    return Field(
        meaning, lambda value: isinstance(value, Integral) and is_number(value, minimum, maximum)
    )


def _range(minimum: float, maximum: float, above: float) -> str:
    """Words for an interval, such as " from 0 to 1"; empty for all numbers."""
    if above >= minimum:
        end = f" to {maximum:.10g}" if maximum < MAX_NUMBER else ""
        return f" above {above:.10g}{end}"
    if maximum < MAX_NUMBER:
        return f" from {minimum:.10g} to {maximum:.10g}"
    if minimum > -MAX_NUMBER:
        return f" of at least {minimum:.10g}"
    return ""


def one_of(*values: str) -> Field:
    """One of these texts."""
    return Field(" or ".join(values), lambda value: isinstance(value, str) and value in values)


def exactly(allowed: Any) -> Field:
    """This value, of the same type."""
    return Field(repr(allowed), lambda value: type(value) is type(allowed) and value == allowed)


def many(field: Field, minimum: int = 0) -> Field:
    """A list of at least ``minimum`` values of a field."""

    def accepts(value: Any) -> bool:
        if not isinstance(value, list) or len(value) < minimum:
            return False
        return all(field.accepts(entry) for entry in value)

    return Field(f"a list of {minimum} or more, each {field.meaning}", accepts)


TEXT = Field("a text", lambda value: isinstance(value, str))
BOOLEAN = Field("true or false", lambda value: isinstance(value, bool))
TABLE = Field("a table", lambda value: isinstance(value, Mapping))


def require(key: str, value: Any, field: Field, where: str | Path | None, remedy: str) -> None:
    """Raise ArtifactError unless the entry ``key`` of a file is as declared."""
    if not field.accepts(value):
        raise ArtifactError(
            f"{key} = {quoted(value)} is not {field.meaning}", where=where, remedy=remedy
        )


def require_argument(name: str, value: Any, field: Field) -> None:
    """Raise ConfigError unless the argument ``name`` is as declared."""
    if not field.accepts(value):
        problem = f"{name} {quoted(value)} is not {field.meaning}"
        raise ConfigError(problem, remedy=f"give {field.meaning}", argument=name)


def require_number(
    name: str, value: Any, minimum: float = 0.0, maximum: float = MAX_NUMBER, positive: bool = False
) -> None:
    """`require_argument` for a finite number in [minimum, maximum], above 0 if ``positive``."""
    above = 0.0 if positive else -inf
    require_argument(name, value, number(minimum, maximum, above))


def require_count(name: str, value: Any, minimum: int = 1, maximum: float = MAX_NUMBER) -> None:
    """`require_argument` for an integer in [minimum, maximum]."""
    require_argument(name, value, integer(minimum, maximum))


def require_range(name: str, value: Any, minimum: float, maximum: float) -> None:
    """`require_argument` for a pair (low, high) of numbers in [minimum, maximum], low <= high."""

    def accepts(pair: Any) -> bool:
        if not isinstance(pair, tuple) or len(pair) != 2:
            return False
        low, high = pair
        is_within = is_number(low, minimum, maximum) and is_number(high, minimum, maximum)
        return is_within and low <= high

    meaning = f"a range within {minimum:g}..{maximum:g}, the smaller number first"
    require_argument(name, value, Field(meaning, accepts))


def require_seed(seed: Any) -> None:
    """`require_argument` for a seed, an integer from 0 to 2³¹ - 1."""
    require_argument("seed", seed, integer(0, MAX_SEED))


def generator_of(seed: int | np.random.Generator) -> np.random.Generator:
    """A new generator with this seed (see `require_seed`), or the given generator itself."""
    if isinstance(seed, np.random.Generator):
        return seed
    require_seed(seed)
    return np.random.default_rng(seed)


def seed_of(*words: int) -> int:
    """A seed of 32 bits, the hash of whole numbers such as a stream's tag, a seed and a count."""
    return int(np.random.SeedSequence(words).generate_state(1, np.uint32)[0])


def require_array(name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    """``value`` as a C-contiguous float64 array; compiled code would read beyond a short array.

    Raises ConfigError for no numbers, another shape, or a number that is not finite.
    """
    remedy = f"give finite numbers of shape {shape}"

    try:
        array = np.ascontiguousarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} is not an array of numbers", remedy=remedy) from error
    if np.shape(value) != shape:
        raise ConfigError(f"{name} has shape {np.shape(value)}, not {shape}", remedy=remedy)

    index = first_not_finite(array)
    if index is not None:
        raise ConfigError(f"{name}{index} is not finite: {array[tuple(index)]}", remedy=remedy)
    return array


def first_not_finite(value: np.ndarray) -> list[int] | None:
    """Indices of the first NaN or infinity in an array; None if all values are finite."""
    finite = np.isfinite(value)
    if finite.all():
        return None
    return np.argwhere(~finite)[0].tolist()
