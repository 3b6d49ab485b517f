"""Checks of logged gains."""

from pathlib import Path

import numpy as np

from motorprior.exceptions import ConfigError, LogError


def checked_gains(gains: np.ndarray, count: int) -> np.ndarray:
    """(2, count) kp and kd; `ConfigError` for another shape, or unless kp > 0 and kd >= 0."""
    gains = np.asarray(gains, dtype=np.float64)
    if gains.shape != (2, count):
        problem = f"gains of shape {gains.shape}, expected (2, {count}): kp and kd of every motor"
        raise ConfigError(problem, remedy="give one column per motor", argument="gains")

    is_valid = np.isfinite(gains).all(axis=0) & (gains[0] > 0.0) & (gains[1] >= 0.0)
    if not is_valid.all():
        first_invalid = gains[:, int(is_valid.argmin())].tolist()
        problem = f"kp and kd {first_invalid} are not valid gains"
        raise ConfigError(problem, remedy="give kp > 0 and kd >= 0", argument="gains")
    return gains


def check_gain_units(gains: np.ndarray, where: str | Path) -> None:
    """Raise `LogError` if the median of logged gains (2, M) cannot be in N·m/rad and N·m·s/rad."""
    kp = float(np.median(gains[0]))
    ratio = float(np.median(gains[1] / gains[0]))
    if 1e-3 <= kp <= 1e3 and not ratio > 10.0:
        return
    raise LogError(
        f"logged gains: median kp = {kp:.4g} N·m/rad, median kd/kp = {ratio:.4g} s; "
        "expected 0.001 to 1000 N·m/rad and at most 10 s",
        where=where,
        remedy='log them in N·m/rad and N·m·s/rad, or set gain = "firmware" in the column map',
    )
