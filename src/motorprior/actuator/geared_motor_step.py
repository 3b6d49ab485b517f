"""A servo motor with rotor, dry friction and gear: its constants, and the formula of one step.

The formula needs ``+ - * / abs > < |`` and the functions of an `Arithmetic`. It runs on lanes of
compiled code (`grey_box`) and on numpy (tests), and imports neither.

All quantities are at the output shaft. A step h takes positions from t to t + h and velocities from
t - h/2 to t + h/2, as the semi-implicit Euler of the engines: forces are evaluated at t, and except
for EXTRA_DAMPING the step is second-order accurate. It is linearly implicit in the rotor's new
velocity v'; the velocity at t is v̄ = (v + v')/2:

    gear      twist = rotor_pos - joint_pos
              s = twist ∓ backlash/2, or 0 within the backlash
              D = gear_damping + EXTRA_DAMPING·h·gear_stiffness
              τ_gear = gear_stiffness·(s + h/2·(v̄ - v)) + D·(v̄ - dq) in contact, 0 otherwise;
              in contact means |twist + h/2·(v - dq)| > backlash/2
    friction  F = coulomb + load_friction·|gear_stiffness·s + D·(v - dq)|
                  + stribeck_torque/(1 + (v/STRIBECK_VELOCITY)²)
    encoder   θ = rotor_pos - hidden_twist·s + h/2·(v̄ - v) + encoder_zero
    control   τ_law = clip(kp·(position_target - θ) + kd·(velocity_target - filtered)
                           + torque_feedforward, ±torque_limit)
    rotor     armature·(v' - v)/h = τ_law - viscous_damping·v̄ - τ_gear - F·sign(v'),
              v' = 0 if F can stop it

kp and kd are the gains in force. The delayed command and the filtered velocity are means from
t - h/2 to t + h/2. Position commands alone have no velocity target and no feed-forward torque, and
their gains are constant. Torque control is kp = kd = 0. A gear that is too
stiff for the step is softened. Softening enlarges the twist s; the share ``hidden_twist`` of s is
this enlargement, and the encoder does not see it.

The engine gets the torque τ_gear + d·dq of the joint and, in gear contact, the damping
d = (gear_damping + h·gear_stiffness)/2, which it integrates implicitly. This keeps a stiff gear on
a light shank stable. The damping takes the momentum h·d·Δ from the joint, where Δ is the change of
dq in this step, and the rotor must get this momentum. Δ is not yet known, so the rotor gets the
momentum of an expected change in this step, and the rest in the next step. Momentum is therefore
conserved, and slow motions are second-order accurate. The expected change is the smaller one of the
last two changes. It is 0 if their signs differ, or if the gear was not in contact, so that impacts
and vibrations are not extrapolated.

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
    at_angle,
    at_operating_conditions,
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
# Maximum gear_stiffness·h²/armature and maximum gear_damping·h/armature. A gear above a maximum
# would be unstable and is softened to it. The encoder does not see the additional twist, since the
# twist would act like a longer delay.
MAX_STIFFNESS = 1.5
MAX_DAMPING = 1.0
# The encoder velocity lacks a share of the twist's rate, which acts like a negative gear damping of
# kd times this share. Maximum of this product relative to the maximum gear damping [-]; more is
# unstable.
MAX_HIDDEN_DAMPING = 0.25
MAX_DELAY = 0.04  # length of a motor's delay line [s]
# maximum |log(constant of a motor / constant of the central motor)|, a factor of 148
MAX_LOG_FACTOR = 5.0
# additional gear damping over h·gear_stiffness, against chatter of a bare shank [-]
EXTRA_DAMPING = 0.1
STRIBECK_VELOCITY = 0.3  # [rad/s]

Values = Any  # one number per motor, in the type of the arithmetic


# Rows that every motor has. They are the constants of PARAMETERS with these changes: kd replaces
# kd_over_kp, half_backlash replaces backlash, and the delay is in steps. MAX_STIFFNESS and
# MAX_DAMPING limit the gear. filter_gain is the gain of the velocity filter per step, and
# mean_filter_gain the gain of its mean over the step. hidden_twist and hidden_twist_rate are the
# shares of the twist and of its rate that the encoder does not see. feedforward_gain is the torque
# per commanded feed-forward torque, which heat, supply and temperature change.
_BASE = (
    "kp", "kd", "filter_gain", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "half_backlash", "gear_damping",
    "encoder_zero", "mean_filter_gain", "hidden_twist", "hidden_twist_rate", "feedforward_gain",
)  # fmt: skip
BASE_CONSTANTS = len(_BASE)
# Constants of motors for steps of one length, in the row order of the compiled step's table
StepConstants = namedtuple("StepConstants", (*_BASE, *STEP_ROWS), defaults=[None] * len(STEP_ROWS))
# State of motors, without the delay line of commands. joint_vel, damping (given to the engine) and
# expected_change are from the previous step; vel_change is the last change of joint_vel. The rows
# of optional terms follow.
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
    raw: np.ndarray, terms: tuple[str, ...] = (), operating_conditions: OperatingConditions = COLD
) -> dict[str, np.ndarray]:
    """Constants by name, each (…), from decoder outputs ``raw`` (…, P).

    A positive constant is exp(raw). A constant of `optional_terms.SIGNED` is a multiple of raw.
    Delays are limited to MAX_DELAY. ``operating_conditions`` are numbers or arrays (…).
    """
    values = {
        name: SIGNED[name] * raw[..., row] if name in SIGNED else np.exp(raw[..., row])
        for row, name in enumerate(parameters_of(terms))
    }
    values["delay"] = np.minimum(values["delay"], MAX_DELAY)
    for name, constant in CONSTANTS.items():
        if constant.max and name in values:
            values[name] = np.clip(values[name], -constant.max, constant.max)
    return at_operating_conditions(operating_conditions, values)


def with_logged_gains(values: dict[str, Values], kp: Values, kd: Values) -> dict[str, Values]:
    """Constants by name of motors with the logged gains ``kp`` and ``kd``.

    The decoded constants are multiples of the logged gains:

        kp' = decoded kp·kp,   kd' = decoded kp·decoded kd_over_kp·kd
    """
    return values | {"kp": values["kp"] * kp, "kd_over_kp": values["kd_over_kp"] * kd / kp}


def step_constants(
    values: dict[str, np.ndarray], h: float, terms: tuple[str, ...] = ()
) -> StepConstants:
    """Constants for steps of ``h`` [s] from constants by name.

    A velocity filter with time constant T has the gain 1 - exp(-h/T) per step; the mean of its
    output over the step has the gain 1 - (1 - exp(-h/T))·T/h. If any optional term is enabled, the
    constants of the other optional terms have no effect.
    """
    kd = values["kp"] * values["kd_over_kp"]
    step_over_filter = h / values["velocity_filter"]
    filter_gain = -np.expm1(-step_over_filter)

    # a gear that is stable at this step
    max_stiffness = MAX_STIFFNESS * values["armature"] / h**2
    stiffness = np.minimum(values["gear_stiffness"], max_stiffness)
    hidden_twist = 1.0 - stiffness / values["gear_stiffness"]

    # the control law does not damp the hidden twist, so a softened gear is damped at least so much
    max_damping = MAX_DAMPING * values["armature"] / h
    min_damping = hidden_twist * max_damping
    gear_damping = np.clip(values["gear_damping"], min_damping, max_damping)

    # limits kd·hidden_twist_rate
    max_hidden_damping = MAX_HIDDEN_DAMPING * max_damping
    hidden_damping = hidden_twist * MAX_HIDDEN_DAMPING * max_damping
    hidden_twist_rate = hidden_damping / np.maximum(max_hidden_damping, kd)

    unchanged_rows = {name: values[name] for name in PARAMETERS if name in _BASE}
    derived_rows = {
        "kd": kd,
        "filter_gain": filter_gain,
        "delay": values["delay"] / h,
        "gear_stiffness": stiffness,
        "half_backlash": 0.5 * values["backlash"],
        "gear_damping": gear_damping,
        "mean_filter_gain": 1.0 - filter_gain / step_over_filter,
        "hidden_twist": hidden_twist,
        "hidden_twist_rate": hidden_twist_rate,
        "feedforward_gain": values.get("feedforward_gain", np.ones_like(filter_gain)),
    }
    optional_rows = step_rows(terms, values, h, np.zeros_like(filter_gain)) if terms else {}
    return StepConstants(**(unchanged_rows | derived_rows | optional_rows))


class CommandFrame(NamedTuple):
    """What a command states besides the position target (MIT mode), delayed like the target.

    The values are means over the step.
    """

    velocity_target: Values  # [rad/s]
    torque_feedforward: Values  # [N·m]
    kp_factor: Values  # gain in force over the kp of the constants [-]
    kd_factor: Values  # gain in force over the kd of the constants [-]


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
    frame: CommandFrame | None = None,
) -> tuple[MotorState, Values, Values]:
    """Advance motors by one step of ``h`` [s], the length that the constants ``p`` are for.

    ``target`` is the mean of the delayed position target over the step [rad]; ``q`` and ``dq`` are
    the position [rad] and the velocity [rad/s] of the joint. ``frame`` is the rest of the command;
    None stands for position commands at constant gains, and gives the same bits as a frame without
    velocity target and feed-forward torque. Returns the state after the step, and the torque [N·m]
    and the damping [N·m·s/rad] of the joint for the engine.
    """
    where = arithmetic.where
    if "profile" in terms:
        state = profiled(p, state, target, h, arithmetic)
        target = state.reference
    r = state.rotor_pos
    filtered = state.filtered_vel
    half_h = 0.5 * h

    # gains in force
    kp = p.kp
    kd = p.kd
    if frame is not None:
        kp = kp * frame.kp_factor
        kd = kd * frame.kd_factor

    # In the last step, the engine's implicit damping took the momentum h·damping·change from the
    # joint, and the rotor got h·damping·expected_change. The rotor gets the rest now.
    change = dq - state.joint_vel
    remaining_momentum = h * state.damping * (change - state.expected_change)
    v = state.rotor_vel + remaining_momentum / p.armature

    # expected change of the joint's velocity in this step
    last_change = state.vel_change
    smaller_change = where(abs(change) < abs(last_change), change, last_change)
    expected = where(change * last_change * state.damping > 0.0, smaller_change, 0.0)

    # Gear at v. If the gear is still within the backlash and comes into contact during the step,
    # its deflection is 0: it already damps, but its spring has no torque.
    twist = r - q
    deflection = twist - arithmetic.clip(twist, p.half_backlash)
    contact = arithmetic.indicator(abs(twist + half_h * (v - dq)) > p.half_backlash)
    stiffness = contact * p.gear_stiffness
    gear_damping = contact * p.gear_damping + EXTRA_DAMPING * h * stiffness
    gear_torque = stiffness * deflection + gear_damping * (v - dq)
    gear_slope = gear_damping + half_h * stiffness  # d(gear torque)/d(v̄)
    damping = 0.5 * (contact * p.gear_damping + h * stiffness)  # for the engine

    # Friction.
    ratio = v / STRIBECK_VELOCITY
    friction = p.coulomb + p.stribeck_torque / (1.0 + ratio * ratio)
    friction = friction + p.load_friction * abs(gear_torque)
    if "angle_friction" in terms:
        friction = at_angle(p, friction, r, arithmetic)

    # Angle and velocity of the encoder, which does not see the hidden twist.
    twist_rate = where(abs(deflection) > 0.0, v - dq, 0.0)
    encoder_pos = r - p.hidden_twist * deflection
    encoder_vel = v - p.hidden_twist_rate * twist_rate
    encoder_slope = 1.0  # d(encoder velocity)/dv
    if "output_encoder" in terms:
        encoder_pos = encoder_pos + p.output_encoder * (q - encoder_pos)
        encoder_vel = encoder_vel + p.output_encoder * (dq - encoder_vel)
        encoder_slope = 1.0 - p.output_encoder * (1.0 - contact)

    # Torque of the control law at v.
    error = target - encoder_pos - p.encoder_zero
    error_slope = 1.0  # 0 within the dead zone
    if "dead_zone" in terms:
        error_slope = arithmetic.indicator(abs(error) > p.dead_zone)
        error = error - arithmetic.clip(error, p.dead_zone)
    mean_filtered = filtered + p.mean_filter_gain * (encoder_vel - filtered)
    law_torque = kp * error - kd * mean_filtered
    if frame is not None:
        feedforward = p.feedforward_gain * frame.torque_feedforward
        law_torque = law_torque + (kd * frame.velocity_target + feedforward)
    if "integral" in terms:
        integral = state.integral + h * p.integral_rate * kp * error
        state = state._replace(integral=arithmetic.clip(integral, p.integral_limit))
        law_torque = law_torque + state.integral
    for name in terms:
        law_of_term = TERMS[name].law
        if law_of_term is not None:
            law_torque = law_of_term(p, law_torque, v, arithmetic)
    # -d(law torque)/d(v̄)
    law_slope = (kd * p.mean_filter_gain + half_h * kp * error_slope) * encoder_slope

    # The motor torque is lagging_torque + law_share·(torque of the control law).
    lagging_torque = 0.0
    law_share = 1.0
    if "current" in terms:
        lagging_torque = (1.0 - p.mean_current_gain) * state.current
        law_share = p.mean_current_gain

    # Momentum balance of the rotor: forces at v, plus their slopes times v̄ - v = (v' - v)/2.
    # ``momentum`` is the rotor's, without the motor torque and friction.
    inertia = p.armature + half_h * (gear_slope + p.viscous_damping)
    resistance = gear_torque + p.viscous_damping * v - damping * expected
    momentum = inertia * v - h * resistance

    def velocity_after(impulse: Values, inertia: Values) -> tuple[Values, Values]:
        """Velocity of the rotor and deflection of the bristle after the step.

        ``impulse`` [N·m·s] is the momentum without friction; friction cannot reverse it.
        """
        limit = friction
        if "asymmetry" in terms:
            limit = limit * (1.0 + where(impulse > 0.0, p.asymmetry, -p.asymmetry))
        if "presliding" not in terms:
            remaining = arithmetic.positive_part(abs(impulse) - h * limit)
            return arithmetic.with_sign_of(remaining, impulse) / inertia, state.bristle

        # velocity if the bristle does not slip
        stiffness = p.bristle_stiffness
        bristle_impulse = h * stiffness * state.bristle
        sticking_vel = (impulse - bristle_impulse) / (inertia + h * h * stiffness)
        force = arithmetic.clip(stiffness * (state.bristle + h * sticking_vel), limit)
        return (impulse - h * force) / inertia, force / stiffness

    # Velocity without the limits of the control law, whose torque depends on v̄.
    motor_torque = lagging_torque + law_share * law_torque
    motor_slope = law_share * law_slope
    free_impulse = momentum + h * motor_torque + half_h * motor_slope * v
    free_inertia = inertia + half_h * motor_slope
    free_vel, free_bristle = velocity_after(free_impulse, free_inertia)
    mean_law_torque = law_torque - 0.5 * law_slope * (free_vel - v)

    # Velocity with the limits, at which the torque is constant in the step.
    limited_torque = arithmetic.clip(mean_law_torque, p.torque_limit)
    if "torque_speed" in terms:
        limited_torque = within_voltage(p, limited_torque, v, arithmetic)
    limited_impulse = momentum + h * (lagging_torque + law_share * limited_torque)
    limited_vel, limited_bristle = velocity_after(limited_impulse, inertia)
    if "torque_speed" in terms:
        is_limited = abs(mean_law_torque - limited_torque) > 0.0
    else:
        is_limited = abs(mean_law_torque) > p.torque_limit
    new_vel = where(is_limited, limited_vel, free_vel)

    # State after the step, and torque and damping for the engine.
    mean_vel = 0.5 * (v + new_vel)
    torque = gear_torque + gear_slope * (mean_vel - v) + damping * dq
    mean_encoder_vel = encoder_vel + encoder_slope * (mean_vel - v)
    moved = state._replace(
        rotor_pos=r + h * new_vel,
        rotor_vel=new_vel,
        filtered_vel=filtered + p.filter_gain * (mean_encoder_vel - filtered),
        joint_vel=dq,
        damping=damping,
        vel_change=change,
        expected_change=expected,
    )
    if "current" in terms:
        commanded = where(is_limited, limited_torque, mean_law_torque)
        current = state.current + p.current_gain * (commanded - state.current)
        moved = moved._replace(current=current)
    if "presliding" in terms:
        moved = moved._replace(bristle=where(is_limited, limited_bristle, free_bristle))
    if "output_damping" in terms:
        damping = damping + p.output_damping
    return moved, torque, damping
