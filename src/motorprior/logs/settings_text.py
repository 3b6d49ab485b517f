"""Text about the settings in a log: gains, firmware registers, voltage, temperature, posture."""

from __future__ import annotations

import numpy as np

from motorprior.logs.motor_log import CONDITION_UNITS, PHYSICAL_GAINS, POSTURES, MotorLog, channels

_GAINS = {"kp": "N·m/rad", "kd": "N·m·s/rad"}
_REGISTERS = {"profile_speed": "rad/s", "profile_acceleration": "rad/s²", "dead_zone": "rad"}


def settings_text(log: MotorLog) -> str:
    """Gains, registers and conditions with units, and postures, separated by semicolons; empty without any."""
    parts = gain_texts(log)
    for name, unit in _REGISTERS.items():
        if name in log.firmware:
            parts.append(f"{name} {log.firmware[name]:.4g} {unit}" if log.firmware[name] else f"{name} off")
    for name, values in channels(log).items():
        if name in CONDITION_UNITS:
            parts.append(f"{name} {range_text(name, values.min(), values.max())}")
    if log.posture is not None:
        parts.append(f"posture {', '.join(POSTURES[code] for code in np.unique(log.posture).tolist())}")
    return "; ".join(parts)


def gain_texts(log: MotorLog) -> list[str]:
    """Each logged gain with its unit; of more than three different values, the range."""
    texts = []
    for name, unit in _GAINS.items():
        if (gains := getattr(log, f"stated_{name}")) is not None:
            values = np.unique(gains).tolist()
            text = ", ".join(f"{value:.4g}" for value in values)
            if len(values) > 3:
                text = f"{values[0]:.4g} to {values[-1]:.4g}"
            texts.append(f"{name} {text} {unit if log.gain_unit == PHYSICAL_GAINS else 'in firmware units'}")
    return texts


def range_text(condition: str, low: float, high: float) -> str:
    """For example "9.6 to 12 V", or "12 V" if both are equal."""
    one, other = f"{low:.3g}", f"{high:.3g}"
    return f"{one if one == other else f'{one} to {other}'} {CONDITION_UNITS[condition]}"
