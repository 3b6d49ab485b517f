"""Constants of a geared servo motor: from decoder outputs to the constants of steps of a given length."""

from __future__ import annotations

from collections import namedtuple
from typing import Any

import numpy as np

from motorprior.actuator.optional_terms import (
    COLD,
    CONSTANTS,
    SIGNED,
    STEP_ROWS,
    Conditions,
    at_conditions,
    constants_of,
    step_rows,
)

# Units as in `physical.MotorParameters`; kd_over_kp [s]
PARAMETERS = (
    "kp", "kd_over_kp", "velocity_filter", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "backlash", "gear_damping", "encoder_zero",
)  # fmt: skip
# Maximum gear_stiffness·h²/armature and gear_damping·h/armature: stiffer gears are softened to this limit, since they
# would be unstable
MAX_STIFFNESS, MAX_DAMPING = 1.5, 1.0
MAX_DELAY = 0.04  # length of a motor's delay line [s]
LOG_REACH = 5.0  # constants of motors are within a factor of 148 of the central motor's
ZERO_SCALE = SIGNED["encoder_zero"]  # [rad]
PER_LOGGED = "_per_stated"  # suffix of constants that are multiples of a logged gain

Values = Any  # one number per motor, in the type of the arithmetic


# Rows that every motor has: as in PARAMETERS, but kd, delay in steps, half_backlash, and a gear that is limited by
# MAX_STIFFNESS and MAX_DAMPING; gains of the velocity filter per step, and of its mean over the step
_BASE = (
    "kp", "kd", "filter_gain", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque", "viscous_damping",
    "load_friction", "gear_stiffness", "half_backlash", "gear_damping", "encoder_zero", "mean_filter_gain",
)  # fmt: skip
BASE_CONSTANTS = len(_BASE)
# Constants of motors for steps of one length; also the rows of the compiled step's table
StepConstants = namedtuple("StepConstants", (*_BASE, *STEP_ROWS), defaults=[None] * len(STEP_ROWS))


def parameters_of(terms: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the constants of motors with these terms, in the order of the decoder outputs."""
    return PARAMETERS + constants_of(terms)


def decode(raw: np.ndarray, terms: tuple[str, ...] = (), conditions: Conditions = COLD) -> dict[str, np.ndarray]:
    """Constants by name, each (…), from decoder outputs (…, P).

    exp(raw), or a multiple of raw for `optional_terms.SIGNED`; delays are limited to MAX_DELAY. ``conditions`` are
    numbers or (…).
    """
    values = {
        name: SIGNED[name] * raw[..., row] if name in SIGNED else np.exp(raw[..., row])
        for row, name in enumerate(parameters_of(terms))
    }
    values["delay"] = np.minimum(values["delay"], MAX_DELAY)
    for name, constant in CONSTANTS.items():
        if constant.max and name in values:
            values[name] = np.clip(values[name], -constant.max, constant.max)
    return at_conditions(conditions, values)


def with_logged_gains(values: dict[str, Values], kp: Values, kd: Values) -> dict[str, Values]:
    """Constants by name with gains kp and kd: kp' = decoded kp·kp, kd' = decoded kp·decoded kd_over_kp·kd."""
    return values | {"kp": values["kp"] * kp, "kd_over_kp": values["kd_over_kp"] * kd / kp}


def named_multiples(values: dict[str, Values]) -> dict[str, Values]:
    """Constants by name; multiples of logged gains are renamed, for example ``kp_per_stated``."""
    return {f"{name}{PER_LOGGED}" if name in ("kp", "kd_over_kp") else name: value for name, value in values.items()}


def step_constants(values: dict[str, np.ndarray], h: float, terms: tuple[str, ...] = ()) -> StepConstants:
    """Constants for steps of ``h`` [s] from constants by name.

    A filter with time constant T has the gain 1 - exp(-h/T) per step; its mean over the step has the gain
    1 - (1 - exp(-h/T))·T/h. If any optional term is enabled, the others get constants without effect.
    """
    steps = h / values["velocity_filter"]
    gain = -np.expm1(-steps)
    same = {name: values[name] for name in PARAMETERS if name in _BASE}
    changed = {
        "kd": values["kp"] * values["kd_over_kp"],
        "filter_gain": gain,
        "delay": values["delay"] / h,
        "gear_stiffness": np.minimum(values["gear_stiffness"], MAX_STIFFNESS * values["armature"] / h**2),
        "half_backlash": 0.5 * values["backlash"],
        "gear_damping": np.minimum(values["gear_damping"], MAX_DAMPING * values["armature"] / h),
        "mean_filter_gain": 1.0 - gain / steps,
    }
    optional = step_rows(terms, values, h, np.zeros_like(gain)) if terms else {}
    return StepConstants(**(same | changed | optional))
