"""What a log states of its motors, in words.

The gains and registers that they were told, the voltage and temperature that they worked at, how the base was held.
"""

from __future__ import annotations

import numpy as np

from motorprior.logs.motor_log import PHYSICAL_GAINS, POSTURES, MotorLog, channels

_GAINS = {"kp": "N·m/rad", "kd": "N·m·s/rad"}
_REGISTERS = {"profile_speed": "rad/s", "profile_acceleration": "rad/s²", "dead_zone": "rad"}
_CONDITIONS = {"supply_voltage": "V", "motor_temperature": "°C"}
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
    parts += [_range(name, getattr(log, name), unit) for name, unit in _CONDITIONS.items() if name in channels(log)]
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


def _range(name: str, values: np.ndarray, unit: str) -> str:
    least, most = (f"{value:.3g}" for value in (values.min(), values.max()))
    return f"{name} {least if least == most else f'{least} to {most}'} {unit}"
