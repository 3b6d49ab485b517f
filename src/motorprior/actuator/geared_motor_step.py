"""One step of a servo motor with rotor, dry friction and gear: the formula, for every arithmetic.

Written once over whatever supports ``+ - * / abs > < |`` and the functions of an `Arithmetic`: lanes of compiled code
(`geared_motor`), JAX (training), numpy (tests). It imports none of them.

All quantities at the output shaft. A step h takes positions from t to t + h and velocities from t - h/2 to t + h/2, as
the engines' own semi-implicit Euler does with the joint's: every force is meant at t, and but for
EXTRA_DAMPING a motion is right to second order in h. Linearly implicit in the rotor's new velocity v'; its velocity at
t is v̄ = (v + v')/2:

    gear      s = twist ∓ backlash/2,  twist = rotor_pos - joint_pos, in contact where twist + h/2·(v - dq) is beyond
              the backlash;  D = gear_damping + EXTRA_DAMPING·h·gear_stiffness
              τ_gear = gear_stiffness·(s + h/2·(v̄ - v)) + D·(v̄ - dq)
    friction  F = coulomb + load_friction·|gear_stiffness·s + D·(v - dq)| + stribeck_torque/(1 + (v/STRIBECK_VELOCITY)²)
    law       τ_law = clip(kp·(position_target - θ) - kd·filtered, ±torque_limit),  θ = rotor_pos + h/2·(v̄ - v) +
              encoder_zero; delayed target and filtered velocity are means over the step, t - h/2 to t + h/2
    rotor     armature·(v' - v)/h = τ_law - viscous_damping·v̄ - τ_gear - F·sign(v'),  stuck where F is enough

The joint gets torque = τ_gear + d·dq and damping d = (gear_damping + h·gear_stiffness)/2 while the gear touches, for
the engine to integrate implicitly: a stiff gear on a light shank then stays stable. What that takes from the joint is
given back to the rotor one step later, so that momentum is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

PARAMETERS = (
    "kp", "kd_over_kp", "velocity_filter", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "backlash", "gear_damping", "encoder_zero",
)  # fmt: skip
"""Units as in `physical.MotorParameters`; kd_over_kp [s]."""
EXTRA_DAMPING = 0.1
"""Of the gear, so that a bare shank does not chatter [steps of its stiffness]."""
RESOLVED = 1.5
"""Largest gear_stiffness·h²/armature: a stiffer gear is simulated as if it were only so stiff, or it would explode."""
LONGEST_DELAY = 0.04
"""[s]; a motor keeps its commands for so long."""
LOG_REACH = 2.5
"""A constant of a drawn motor is within a factor of 12 of the central motor's."""
ZERO_SCALE = 0.05
"""[rad]"""
STRIBECK_VELOCITY = 0.3
"""[rad/s]"""
_ENCODER_ZERO = PARAMETERS.index("encoder_zero")

Values = Any
"""Numbers of as many motors as are stepped at once, in the arithmetic's own type."""


class Arithmetic(NamedTuple):
    """What the operators of a kind of `Values` leave out."""

    where: Callable[[Any, Any, Any], Values]
    """(condition, yes, no), element by element; ``yes`` and ``no`` may be plain numbers."""
    indicator: Callable[[Any], Values]
    """1 where the condition holds, 0 elsewhere."""
    clip: Callable[[Values, Values], Values]
    """(x, limit): x within ±limit."""
    positive_part: Callable[[Values], Values]
    """max(x, 0); what is not a number stays it."""
    with_sign_of: Callable[[Values, Values], Values]
    """(magnitude, other): the magnitude, with the sign of ``other``."""


def array_arithmetic(xp: Any) -> Arithmetic:
    """The arithmetic of an array module, numpy or jax.numpy.

    Its sign of 0 is 0, so that the derivative of a rotor at rest by its impulse is 0 and not undefined.
    """
    return Arithmetic(
        where=xp.where,
        indicator=lambda condition: 1.0 * condition,
        clip=lambda x, limit: xp.clip(x, -limit, limit),
        positive_part=lambda x: xp.maximum(x, 0.0),
        with_sign_of=lambda magnitude, other: xp.sign(other) * magnitude,
    )


class StepConstants(NamedTuple):
    """Constants of motors as a step of one length wants them; also the rows of the compiled step's table."""

    kp: Values
    kd: Values
    filter_gain: Values
    """share of the way to its input that the filtered velocity goes in a step [-]"""
    delay: Values
    """[steps]"""
    torque_limit: Values
    armature: Values
    coulomb: Values
    stribeck_torque: Values
    viscous_damping: Values
    load_friction: Values
    gear_stiffness: Values
    """not above what a step resolves"""
    half_backlash: Values
    gear_damping: Values
    encoder_zero: Values
    mean_filter_gain: Values
    """the same share, of the filtered velocity's mean over the step [-]"""


class MotorState(NamedTuple):
    """What a motor remembers from step to step, besides its commands."""

    rotor_pos: Values
    rotor_vel: Values
    filtered_vel: Values
    joint_vel: Values
    """at the step before"""
    damping: Values
    """that the engine was given at the step before"""


def decode(raw: Values, xp: Any) -> dict[str, Values]:
    """Constants by name, each (…), from the decoder's outputs (…, P); the array module ``xp`` is numpy or jax.numpy.

    exp(raw) for every one but encoder_zero = ZERO_SCALE·raw, which may be negative; no delay is above LONGEST_DELAY.
    """
    values = {name: xp.exp(raw[..., row]) for row, name in enumerate(PARAMETERS)}
    values["delay"] = xp.minimum(values["delay"], LONGEST_DELAY)
    values["encoder_zero"] = ZERO_SCALE * raw[..., _ENCODER_ZERO]
    return values


def step_constants(values: dict[str, Values], h: float, xp: Any) -> StepConstants:
    """Constants for steps of ``h`` [s] from constants by name; ``xp`` as in `decode`.

    Of a filter with time constant T, the velocity after a step moves by 1 - exp(-h/T) towards the input, its mean over
    the step by 1 - (1 - exp(-h/T))·T/h.
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
        "mean_filter_gain": 1.0 - gain / steps,
    }
    return StepConstants(**(same | changed))


def step(
    p: StepConstants, state: MotorState, target: Values, q: Values, dq: Values, h: Any, arithmetic: Arithmetic
) -> tuple[MotorState, Values, Values]:
    """Advance motors by one step.

    Args:
        p: constants for steps of this length.
        state: at its start.
        target: delayed position target, mean over the step [rad].
        q: joint position [rad].
        dq: joint velocity [rad/s].
        h: length of the step [s].
        arithmetic: of the values.

    Returns:
        The state after the step, and for the engine torque [N·m] and damping [N·m·s/rad] of the joint.
    """
    where = arithmetic.where
    r, filtered, half_h = state.rotor_pos, state.filtered_vel, 0.5 * h
    # the momentum that the engine's implicit damping took from the joint
    v = state.rotor_vel + h * state.damping * (dq - state.joint_vel) / p.armature

    twist = r - q
    coming = twist + half_h * (v - dq)
    above, below = coming > p.half_backlash, coming < -p.half_backlash
    pressed = where(above, twist - p.half_backlash, where(below, twist + p.half_backlash, 0.0))
    contact = arithmetic.indicator(above | below)
    stiffness = contact * p.gear_stiffness
    damping = 0.5 * (contact * p.gear_damping + h * stiffness)
    damper = contact * p.gear_damping + EXTRA_DAMPING * h * stiffness
    gear, lead = stiffness * pressed + damper * (v - dq), damper + half_h * stiffness

    ratio = v / STRIBECK_VELOCITY
    friction = p.coulomb + p.stribeck_torque / (1.0 + ratio * ratio)
    friction = h * (friction + p.load_friction * abs(gear))
    # forces are those at v, plus their slopes times v̄ - v = (v' - v)/2
    push = p.kp * (target - r - p.encoder_zero) - p.kd * (filtered + p.mean_filter_gain * (v - filtered))
    braking = p.kd * p.mean_filter_gain + half_h * p.kp
    inertia = p.armature + half_h * (lead + p.viscous_damping)
    carried = inertia * v - h * (gear + p.viscous_damping * v)
    free = _after_friction(carried + h * push + half_h * braking * v, friction, arithmetic)
    free = free / (inertia + half_h * braking)
    law = push - 0.5 * braking * (free - v)
    held = _after_friction(carried + h * arithmetic.clip(law, p.torque_limit), friction, arithmetic) / inertia
    after = where(abs(law) > p.torque_limit, held, free)

    mean = 0.5 * (v + after)
    torque = gear + lead * (mean - v) + damping * dq
    moved = MotorState(r + h * after, after, filtered + p.filter_gain * (mean - filtered), dq, damping)
    return moved, torque, damping


def _after_friction(impulse: Values, friction: Values, arithmetic: Arithmetic) -> Values:
    """What dry friction leaves of an impulse: it can stop a rotor, never reverse it."""
    return arithmetic.with_sign_of(arithmetic.positive_part(abs(impulse) - friction), impulse)
