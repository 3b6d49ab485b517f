"""Constants of a geared servo motor: from a decoder's outputs to what a step of one length computes with.

For every arithmetic, as the step itself (`geared_motor_step`).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from motorprior.actuator.optional_terms import (
    ABSENT,
    COLD,
    LARGEST_SHARE,
    SIGNED,
    Conditions,
    at_conditions,
    constants_of,
)

# Units as in `physical.MotorParameters`; kd_over_kp [s]
PARAMETERS = (
    "kp", "kd_over_kp", "velocity_filter", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "backlash", "gear_damping", "encoder_zero",
)  # fmt: skip
# Largest gear_stiffness·h²/armature: a stiffer gear is simulated as if it were only so stiff, or it would explode
RESOLVED = 1.5
DAMPED = 1.0  # Largest gear_damping·h/armature: from 2 on a rotor so light swings up on what its joint gives back
LONGEST_DELAY = 0.04  # [s]; a motor keeps its commands for so long
LOG_REACH = 2.5  # A constant of a drawn motor is within a factor of 12 of the central motor's
ZERO_SCALE = SIGNED["encoder_zero"]  # [rad]
PER_LOGGED = "_per_stated"  # Ending of the name of a constant that is a multiple of a stated gain

Values = Any  # Numbers of as many motors as are stepped at once, in the arithmetic's own type


class StepConstants(NamedTuple):
    """Constants of motors as a step of one length wants them; also the rows of the compiled step's table."""

    kp: Values
    kd: Values
    filter_gain: Values  # share of the way to its input that the filtered velocity goes in a step [-]
    delay: Values  # [steps]
    torque_limit: Values
    armature: Values
    coulomb: Values
    stribeck_torque: Values
    viscous_damping: Values
    load_friction: Values
    gear_stiffness: Values  # not above what a step resolves
    half_backlash: Values
    gear_damping: Values
    encoder_zero: Values
    mean_filter_gain: Values  # the same share, of the filtered velocity's mean over the step [-]
    # 1 where the law sees the joint, 0 where it sees the rotor; this and what follows only with terms
    output_encoder: Values = None
    profile_speed: Values = None
    profile_acceleration: Values = None
    dead_zone: Values = None
    integral_rate: Values = None
    integral_limit: Values = None
    stall_torque: Values = None
    no_load_speed: Values = None
    current_gain: Values = None  # share of the way to the law's torque that the current goes in a step [-]
    mean_current_gain: Values = None  # the same share, of the current's mean over the step [-]
    asymmetry: Values = None
    bristle_stiffness: Values = None
    output_damping: Values = None


BASE_CONSTANTS = StepConstants._fields.index("output_encoder")  # Number of fields that every motor has


def parameters_of(terms: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the constants of motors with these terms, in the order of the decoder's outputs."""
    return PARAMETERS + constants_of(terms)


def decode(raw: Values, xp: Any, terms: tuple[str, ...] = (), conditions: Conditions = COLD) -> dict[str, Values]:
    """Constants by name, each (…), from the decoder's outputs (…, P); the array module ``xp`` is numpy or jax.numpy.

    exp(raw) for every one but those of `optional_terms.SIGNED`; no delay is above LONGEST_DELAY. They are those at
    these ``conditions``, each a number or (…).
    """
    values = {
        name: SIGNED[name] * raw[..., row] if name in SIGNED else xp.exp(raw[..., row])
        for row, name in enumerate(parameters_of(terms))
    }
    values["delay"] = xp.minimum(values["delay"], LONGEST_DELAY)
    for share in ("asymmetry", "heat_loss"):
        if share in values:
            values[share] = xp.clip(values[share], -LARGEST_SHARE, LARGEST_SHARE)
    return at_conditions(conditions, values, xp)


def with_logged_gains(values: dict[str, Values], kp: Values, kd: Values) -> dict[str, Values]:
    """Constants by name of motors with these gains, of which the decoded ones are multiples.

    kp' = decoded kp·kp, kd' = decoded kp·decoded kd_over_kp·kd.
    """
    return values | {"kp": values["kp"] * kp, "kd_over_kp": values["kd_over_kp"] * kd / kp}


def named_multiples(values: dict[str, Values]) -> dict[str, Values]:
    """Constants by name; those that are multiples of logged gains are renamed, for example ``kp_per_stated``."""
    return {f"{name}{PER_LOGGED}" if name in ("kp", "kd_over_kp") else name: value for name, value in values.items()}


def step_constants(values: dict[str, Values], h: float, xp: Any, terms: tuple[str, ...] = ()) -> StepConstants:
    """Constants for steps of ``h`` [s] from constants by name; ``xp`` as in `decode`.

    Of a filter with time constant T, the velocity after a step moves by 1 - exp(-h/T) towards the input, its mean over
    the step by 1 - (1 - exp(-h/T))·T/h. With any term on, the constants of the others are those that do nothing.
    """
    steps = h / values["velocity_filter"]
    gain = -xp.expm1(-steps)
    same = {name: values[name] for name in PARAMETERS if name in StepConstants._fields}
    changed = {
        "kd": values["kp"] * values["kd_over_kp"],
        "filter_gain": gain,
        "delay": values["delay"] / h,
        "gear_stiffness": xp.minimum(values["gear_stiffness"], RESOLVED * values["armature"] / h**2),
        "half_backlash": 0.5 * values["backlash"],
        "gear_damping": xp.minimum(values["gear_damping"], DAMPED * values["armature"] / h),
        "mean_filter_gain": 1.0 - gain / steps,
    }
    if terms:
        nothing = xp.zeros_like(gain)
        full = {name: values.get(name, nothing + absent) for name, absent in ABSENT.items()}
        lags = h / full.pop("current_time")
        full |= {"current_gain": -xp.expm1(-lags), "mean_current_gain": 1.0 + xp.expm1(-lags) / lags}
        changed |= full | {"output_encoder": nothing + ("output_encoder" in terms)}
    return StepConstants(**(same | changed))
