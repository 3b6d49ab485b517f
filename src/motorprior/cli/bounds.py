"""Bounds of the numbers on the command line, checked before anything runs or is written."""

from __future__ import annotations

from motorprior.exceptions import ConfigError

LARGEST_SEED = 2**31 - 1


def require_at_least(least: int, **options: float | None) -> None:
    """Refuse options, by the names they have on the command line, that are too small or not finite.

    Args:
        least: the smallest value allowed.
        options: their values; None means not given.

    Raises:
        ConfigError: names the option and its value.
    """
    for name, value in options.items():
        if value is not None and not least <= value < float("inf"):
            problem = f"is below {least}" if value < least else "is not finite"
            raise ConfigError(f"{_option(name)} {value} {problem}", remedy=f"give {least} or more")


def require_at_most(most: float, **options: float) -> None:
    """Refuse options that are too large.

    Raises:
        ConfigError: names the option and its value.
    """
    for name, value in options.items():
        if value > most:
            raise ConfigError(f"{_option(name)} {value} is above {most}", remedy=f"give {most} or less")


def require_seed(seed: int) -> None:
    """Refuse a seed that a random number generator does not take.

    Raises:
        ConfigError: below 0 or beyond 31 bits.
    """
    require_at_least(0, seed=seed)
    require_at_most(LARGEST_SEED, seed=seed)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
