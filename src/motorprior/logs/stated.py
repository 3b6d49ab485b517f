"""What a log states of its motors, in words.

The gains and registers that they were told, the voltage and temperature that they worked at, how the base was held.
"""

from __future__ import annotations

import numpy as np

from motorprior.logs.motor_log import CONDITION_UNITS, PHYSICAL_GAINS, POSTURES, MotorLog, channels

_GAINS = {"kp": "N·m/rad", "kd": "N·m·s/rad"}
_REGISTERS = {"profile_speed": "rad/s", "profile_acceleration": "rad/s²", "dead_zone": "rad"}
_MOST_VALUES = 3
"""Different gains that are named one by one; of more, the smallest and the largest."""


def stated_in_words(log: MotorLog) -> str:
    """Gains, registers and conditions with their units, and postures, between semicolons; empty if none is stated."""
    parts = gains_in_words(log)
    parts += [
        f"{name} {f'{log.firmware[name]:.4g} {unit}' if log.firmware[name] else 'off'}"
        for name, unit in _REGISTERS.items()
        if name in log.firmware
    ]
    stated = {name: values for name, values in channels(log).items() if name in CONDITION_UNITS}
    parts += [f"{name} {range_in_words(name, values.min(), values.max())}" for name, values in stated.items()]
    if log.posture is not None:
        parts.append(f"posture {', '.join(POSTURES[code] for code in np.unique(log.posture).tolist())}")
    return "; ".join(parts)


def gains_in_words(log: MotorLog) -> list[str]:
    """Each gain that a log states, with its unit."""
    return [_gain(log, name) for name in _GAINS if getattr(log, f"stated_{name}") is not None]


def _gain(log: MotorLog, name: str) -> str:
    values = np.unique(getattr(log, f"stated_{name}")).tolist()
    told = ", ".join(f"{value:.4g}" for value in values)
    if len(values) > _MOST_VALUES:
        told = f"{values[0]:.4g} to {values[-1]:.4g}"
    return f"{name} {told} {_GAINS[name] if log.gain_unit == PHYSICAL_GAINS else 'in units of the firmware'}"


def range_in_words(condition: str, least: float, most: float) -> str:
    """For example "9.6 to 12 V", or "12 V" where both are the same."""
    one, other = f"{least:.3g}", f"{most:.3g}"
    return f"{one if one == other else f'{one} to {other}'} {CONDITION_UNITS[condition]}"
