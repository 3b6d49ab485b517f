"""A servo motor with rotor, dry friction and gear: its constants, and the formula of one step.

The formula needs ``+ - * / abs > < |`` and the functions of an `Arithmetic`. It runs on lanes of
compiled code (`geared_motor`) and on numpy (tests), and imports neither.

All quantities are at the output shaft. A step h takes positions from t to t + h and velocities from
t - h/2 to t + h/2, as the semi-implicit Euler of the engines: forces are evaluated at t, and except
for EXTRA_DAMPING the step is second-order accurate. It is linearly implicit in the rotor's new
velocity v'; the velocity at t is v̄ = (v + v')/2:

    gear      s = twist ∓ backlash/2, or 0 within the backlash,  twist = rotor_pos - joint_pos,
              in contact where
              twist + h/2·(v - dq) is beyond the backlash
              D = gear_damping + EXTRA_DAMPING·h·gear_stiffness
              τ_gear = gear_stiffness·(s + h/2·(v̄ - v)) + D·(v̄ - dq)
    friction  F = coulomb + load_friction·|gear_stiffness·s + D·(v - dq)|
                  + stribeck_torque/(1 + (v/STRIBECK_VELOCITY)²)
    encoder   θ = rotor_pos - softened·s + h/2·(v̄ - v) + encoder_zero
    control   τ_law = clip(kp·(position_target - θ) - kd·filtered, ±torque_limit)
    rotor     armature·(v' - v)/h = τ_law - viscous_damping·v̄ - τ_gear - F·sign(v'),
              v' = 0 if F can stop it

The delayed target and the filtered velocity are means from t - h/2 to t + h/2. A gear that is too
stiff for the step is softened; ``softened`` is the share of its twist s that this adds.

The joint gets torque = τ_gear + d·dq and, in gear contact, damping d = (gear_damping +
h·gear_stiffness)/2, which the engine integrates implicitly: a stiff gear on a light shank is then
stable. The rotor gets the momentum of that damping in the same step, for an expected velocity
change, and the difference to the actual one a step later: momentum is conserved, and slow motions
are second-order accurate. Expected is the smaller of the last two changes while the gear stays in
contact, and 0 if their signs differ, so that impacts and vibrations are not extrapolated.

Optional terms add a firmware profile, an integral, a voltage limit and others (`optional_terms`).
"""

from collections import namedtuple
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from motorprior.actuator.optional_terms import (
    COLD,
    CONSTANTS,
    SIGNED,
    STATE_ROWS,
    STEP_ROWS,
    TERMS,
    OperatingConditions,
    at_conditions,
    constants_of,
    profiled,
    step_rows,
    within_voltage,
)

# Units as in `physical.PhysicalMotors`; kd_over_kp [s]
PARAMETERS = (
    "kp", "kd_over_kp", "velocity_filter", "delay", "torque_limit", "armature", "coulomb",
    "stribeck_torque", "viscous_damping", "load_friction", "gear_stiffness", "backlash",
    "gear_damping", "encoder_zero",
)  # fmt: skip
# Maximum gear_stiffness·h²/armature and gear_damping·h/armature: stiffer gears are softened to this
# limit, since they would be unstable; encoders do not see the additional twist, which would act
# like a longer delay
MAX_STIFFNESS = 1.5
MAX_DAMPING = 1.0
# kd of the twist's rate that encoders do not see, over the maximum gear damping; more is unstable
MAX_RATE = 0.25
MAX_DELAY = 0.04  # length of a motor's delay line [s]
LOG_REACH = 5.0  # constants of motors are within a factor of 148 of the central motor's
# additional gear damping over h·gear_stiffness, against chatter of a bare shank [-]
EXTRA_DAMPING = 0.1
STRIBECK_VELOCITY = 0.3  # [rad/s]
PER_LOGGED = "_per_logged"  # suffix of constants that are multiples of a logged gain

Values = Any  # one number per motor, in the type of the arithmetic


# Rows that every motor has: as in PARAMETERS, but kd, delay in steps, half_backlash, and a gear
# that is limited by MAX_STIFFNESS and MAX_DAMPING; gains of the velocity filter per step, and of
# its mean over the step
_BASE = (
    "kp", "kd", "filter_gain", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "half_backlash", "gear_damping",
    "encoder_zero", "mean_filter_gain", "softened", "softened_rate",
)  # fmt: skip
BASE_CONSTANTS = len(_BASE)
# Constants of motors for steps of one length; also the rows of the compiled step's table
StepConstants = namedtuple("StepConstants", (*_BASE, *STEP_ROWS), defaults=[None] * len(STEP_ROWS))
# State of motors, without the delay line of commands. joint_vel, damping (given to the engine) and
# expected_change have the values of the previous step; vel_change is the last change of joint_vel.
# Rows of optional terms follow, if any.
_STATE = (
    "rotor_pos",
    "rotor_vel",
    "filtered_vel",
    "joint_vel",
    "damping",
    "vel_change",
    "expected_change",
)
BASE_STATE = len(_STATE)
MotorState = namedtuple("MotorState", (*_STATE, *STATE_ROWS), defaults=[None] * len(STATE_ROWS))


def parameters_of(terms: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the constants of motors with these terms, in the order of the decoder outputs."""
    return PARAMETERS + constants_of(terms)


def decode(
    raw: np.ndarray, terms: tuple[str, ...] = (), conditions: OperatingConditions = COLD
) -> dict[str, np.ndarray]:
    """Constants by name, each (…), from decoder outputs (…, P).

    exp(raw), or a multiple of raw for `optional_terms.SIGNED`; delays are limited to MAX_DELAY.
    ``conditions`` are numbers or (…).
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
    """Constants by name with gains kp and kd.

    kp' = decoded kp·kp,   kd' = decoded kp·decoded kd_over_kp·kd
    """
    return values | {"kp": values["kp"] * kp, "kd_over_kp": values["kd_over_kp"] * kd / kp}


def step_constants(
    values: dict[str, np.ndarray], h: float, terms: tuple[str, ...] = ()
) -> StepConstants:
    """Constants for steps of ``h`` [s] from constants by name.

    A filter with time constant T has the gain 1 - exp(-h/T) per step; its mean over the step has
    the gain 1 - (1 - exp(-h/T))·T/h. If any optional term is enabled, the others get constants
    without effect.
    """
    steps = h / values["velocity_filter"]
    filter_gain = -np.expm1(-steps)
    same = {name: values[name] for name in PARAMETERS if name in _BASE}
    kd = values["kp"] * values["kd_over_kp"]
    max_damping = MAX_DAMPING * values["armature"] / h
    stiffness = np.minimum(values["gear_stiffness"], MAX_STIFFNESS * values["armature"] / h**2)
    softened = 1.0 - stiffness / values["gear_stiffness"]
    max_rate = MAX_RATE * max_damping
    changed = {
        "kd": kd,
        "filter_gain": filter_gain,
        "delay": values["delay"] / h,
        "gear_stiffness": stiffness,
        "half_backlash": 0.5 * values["backlash"],
        # the control law does not damp the twist that the encoder does not see
        "gear_damping": np.clip(values["gear_damping"], softened * max_damping, max_damping),
        "mean_filter_gain": 1.0 - filter_gain / steps,
        "softened": softened,
        "softened_rate": softened * MAX_RATE * max_damping / np.maximum(max_rate, kd),
    }
    optional = step_rows(terms, values, h, np.zeros_like(filter_gain)) if terms else {}
    return StepConstants(**(same | changed | optional))


class Arithmetic(NamedTuple):
    """Element-wise functions on a type of `Values` that have no operator."""

    # (condition, yes, no); ``yes`` and ``no`` may be plain numbers
    where: Callable[[Any, Any, Any], Values]
    indicator: Callable[[Any], Values]  # 1 where the condition is true, 0 elsewhere
    clip: Callable[[Values, Values], Values]  # (x, limit): x within ±limit
    positive_part: Callable[[Values], Values]  # max(x, 0); NaN stays NaN
    # (magnitude, other): the magnitude with the sign of ``other``
    with_sign_of: Callable[[Values, Values], Values]
    sqrt: Callable[[Values], Values]  # defined for numbers >= 0


def step(
    p: StepConstants,
    state: MotorState,
    target: Values,
    q: Values,
    dq: Values,
    h: Any,
    arithmetic: Arithmetic,
    terms: tuple[str, ...] = (),
) -> tuple[MotorState, Values, Values]:
    """Advance motors by one step of ``h`` [s], the length that the constants ``p`` are for.

    ``target`` is the delayed position target, mean over the step [rad]; ``q`` and ``dq`` are
    position [rad] and velocity [rad/s] of the joint. Returns the state after the step, and torque
    [N·m] and damping [N·m·s/rad] of the joint for the engine.
    """
    where = arithmetic.where
    if "profile" in terms:
        state = profiled(p, state, target, h, arithmetic)
        target = state.reference
    r = state.rotor_pos
    filtered = state.filtered_vel
    half_h = 0.5 * h

    # The rotor gets the momentum that the engine's implicit damping took from the joint, except for
    # the part that it got in advance.
    change = dq - state.joint_vel
    last_change = state.vel_change
    v = state.rotor_vel + h * state.damping * (change - state.expected_change) / p.armature
    smaller_change = where(abs(change) < abs(last_change), change, last_change)
    expected = where(change * last_change * state.damping > 0.0, smaller_change, 0.0)

    # Gear.
    twist = r - q
    # contact that begins within the step damps, but does not pull
    deflection = twist - arithmetic.clip(twist, p.half_backlash)
    contact = arithmetic.indicator(abs(twist + half_h * (v - dq)) > p.half_backlash)
    stiffness = contact * p.gear_stiffness
    damping = 0.5 * (contact * p.gear_damping + h * stiffness)
    damper = contact * p.gear_damping + EXTRA_DAMPING * h * stiffness
    gear = stiffness * deflection + damper * (v - dq)
    lead = damper + half_h * stiffness

    # Friction.
    ratio = v / STRIBECK_VELOCITY
    friction = p.coulomb + p.stribeck_torque / (1.0 + ratio * ratio)
    friction = friction + p.load_friction * abs(gear)

    # Encoder angle and velocity, without the twist that MAX_STIFFNESS adds; ``follows`` is the
    # slope of the velocity by v.
    twisting = where(abs(deflection) > 0.0, v - dq, 0.0)
    encoder_pos = r - p.softened * deflection
    encoder_vel = v - p.softened_rate * twisting
    follows = 1.0
    if "output_encoder" in terms:
        encoder_pos = encoder_pos + p.output_encoder * (q - encoder_pos)
        encoder_vel = encoder_vel + p.output_encoder * (dq - encoder_vel)
        follows = 1.0 - p.output_encoder * (1.0 - contact)

    # Control law at v: ``push``. ``braking`` is its slope by v; ``active`` is 1 outside the dead
    # zone, 0 within.
    error = target - encoder_pos - p.encoder_zero
    active = 1.0
    if "dead_zone" in terms:
        active = arithmetic.indicator(abs(error) > p.dead_zone)
        error = error - arithmetic.clip(error, p.dead_zone)
    push = p.kp * error - p.kd * (filtered + p.mean_filter_gain * (encoder_vel - filtered))
    if "integral" in terms:
        integral = state.integral + h * p.integral_rate * p.kp * error
        state = state._replace(integral=arithmetic.clip(integral, p.integral_limit))
        push = push + state.integral
    for name in terms:
        law_of_term = TERMS[name].law
        if law_of_term is not None:
            push = law_of_term(p, push, v, arithmetic)
    braking = (p.kd * p.mean_filter_gain + half_h * p.kp * active) * follows

    # Torque of the motor = old + share·torque of the control law.
    old = 0.0
    share = 1.0
    if "current" in terms:
        old = (1.0 - p.mean_current_gain) * state.current
        share = p.mean_current_gain

    # Momentum balance of the rotor: forces at v, plus their slopes times v̄ - v = (v' - v)/2.
    inertia = p.armature + half_h * (lead + p.viscous_damping)
    carried = inertia * v - h * (gear + p.viscous_damping * v - damping * expected)

    def velocity_after(impulse: Values, inertia: Values) -> tuple[Values, Values]:
        """Rotor velocity after an impulse [N·m·s] less friction, and bristle deflection.

        Friction cannot reverse the impulse.
        """
        limit = friction
        if "asymmetry" in terms:
            limit = limit * (1.0 + where(impulse > 0.0, p.asymmetry, -p.asymmetry))
        if "presliding" not in terms:
            remaining = arithmetic.positive_part(abs(impulse) - h * limit)
            return arithmetic.with_sign_of(remaining, impulse) / inertia, state.bristle

        stiffness = p.bristle_stiffness
        yielding = (impulse - h * stiffness * state.bristle) / (inertia + h * h * stiffness)
        force = arithmetic.clip(stiffness * (state.bristle + h * yielding), limit)
        return (impulse - h * force) / inertia, force / stiffness

    # Velocity without and with the limits of the control law.
    in_force = old + share * push
    eased = share * braking
    free, bristle = velocity_after(
        carried + h * in_force + half_h * eased * v, inertia + half_h * eased
    )
    control_law = push - 0.5 * braking * (free - v)
    bounded = arithmetic.clip(control_law, p.torque_limit)
    if "torque_speed" in terms:
        bounded = within_voltage(p, bounded, v, arithmetic)
    bounded_vel, bounded_bristle = velocity_after(carried + h * (old + share * bounded), inertia)
    if "torque_speed" in terms:
        limited = abs(control_law - bounded) > 0.0
    else:
        limited = abs(control_law) > p.torque_limit
    after = where(limited, bounded_vel, free)

    # State after the step, and what the engine gets.
    mean_vel = 0.5 * (v + after)
    torque = gear + lead * (mean_vel - v) + damping * dq
    mean_encoder_vel = encoder_vel + follows * (mean_vel - v)
    moved = state._replace(
        rotor_pos=r + h * after,
        rotor_vel=after,
        filtered_vel=filtered + p.filter_gain * (mean_encoder_vel - filtered),
        joint_vel=dq,
        damping=damping,
        vel_change=change,
        expected_change=expected,
    )
    if "current" in terms:
        commanded = where(limited, bounded, control_law)
        current = state.current + p.current_gain * (commanded - state.current)
        moved = moved._replace(current=current)
    if "presliding" in terms:
        moved = moved._replace(bristle=where(limited, bounded_bristle, bristle))
    if "output_damping" in terms:
        damping = damping + p.output_damping
    return moved, torque, damping
