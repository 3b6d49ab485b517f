"""What a prior's logs did not show of its motors, limits and the size of torques: metrics of the prior, and words."""

from __future__ import annotations

from collections.abc import Mapping

# Beginning of the name of such a metric; its value is the largest that a motor was given [N·m], [rad/s]
NOT_SHOWN = "not_shown_"
# Name of the metric that tells how many motors' logs do not show how large their torques are
UNKNOWN_SIZE = "unknown_torque_size"
_UNITS = {"torque_limit": "N·m"}  # Of limits; others are speeds


def limits_not_shown(metrics: Mapping[str, float]) -> dict[str, float]:
    """Name -> value of the limits that metrics of a prior tell of."""
    return {name.removeprefix(NOT_SHOWN): value for name, value in metrics.items() if name.startswith(NOT_SHOWN)}


def limit_in_words(name: str, value: float) -> str:
    """For example "torque limit of 20 N·m"."""
    return f"{name.replace('_', ' ')} of {value:.3g} {_UNITS.get(name, 'rad/s')}"
