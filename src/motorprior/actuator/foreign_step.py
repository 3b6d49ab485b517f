"""Foreign motors, the compiled step: a second truth, most of whose equations no learned decoder has.

All quantities at the output shaft; x, w are position and velocity of the rotor, q, dq of the joint, which moves at
constant velocity within a step. Per substep h (<= 0.1 ms), and per tick of the firmware, every T = servo_period:

    profile   v = clip(sqrt((a·T)² + 2·a·|d|) - a·T, ..profile_speed)·sign(d), at most a·T from the last v
              reference += T·v,   with d = position_target(t - delay) - reference, a = profile_acceleration
    encoder   θ = round((x or q + encoder_zero) / encoder_quantum)·encoder_quantum, at the time of the tick
    velocity  u += (1 - exp(-T / velocity_filter))·((θ - θ_last) / T - u)
    law       e = deadzone(reference - θ, dead_zone),   I = clip(I + T·ki·e, ±integral_limit)
              command = clip(kp·e + I - kd·u, ±torque_limit), held until the next tick
    voltage   |command| <= stall_torque - sag·|τ| - stall_torque·w / no_load_speed in the driving direction
    current   τ += (1 - exp(-h / current_time))·(command - τ)
    heat      warmth += (1 - exp(-h / heat_time))·(1 - warmth)
    motor     τ_motor = τ·(1 - heat_loss·warmth)·(1 + ripple·sin(ripple_order·x + ripple_phase))
                        - cogging·sin(cogging_order·x + cogging_phase)
    gear      s = deadzone(x - q, backlash / 2)
              y = clip(y + slider_stiffness·Δs, ±slider_torque), zero in the play
              τ_gear = gear_stiffness·s + gear_hardening·s³ + y + gear_damping·(w - dq) in contact, never pulling
    friction  g = (coulomb + static_torque·exp(-(w / stribeck_velocity)²))·(1 + asymmetry·sign(w))
                  ·(1 + position_friction·sin(position_order·x + position_phase)) + load_friction·|τ_gear|
              dz/dt = w - bristle_stiffness·|w|·z / g
              F = bristle_stiffness·z + bristle_damping·exp(-(w / stribeck_velocity)²)·dz/dt
    rotor     armature·dw/dt = τ_motor - τ_gear - F - viscous_damping·w

z takes its exact solution for the velocity at the start of the substep, which no bristle is too stiff for; viscous
damping is implicit. A term is off where its first constant is 0, a firmware of period 0 ticks every substep. The joint
gets the mean of τ_gear over the substeps, and the engine damps it by output_damping·dq.

Sources. Friction: Canudas de Wit, Olsson, Åström and Lischinsky, A new model for control of systems with friction, IEEE
TAC 40 (1995); damping of the bristles that falls with speed, and friction that differs by direction: Olsson et al.,
Friction models and friction compensation, Eur. J. Control 4 (1998); growth with the load: Bittencourt and Gunnarsson,
Static friction in a robot joint, ASME J. Dyn. Sys. 134 (2012). Friction and ripple over the position, hardening of the
gear: Tuttle and Seering, A nonlinear model of a harmonic drive gear transmission, IEEE T-RA 12 (1996). Spring and
slider: Iwan, A distributed-element model for hysteresis, J. Appl. Mech. 33 (1966), one Jenkins element. Profile, dead
zone, integral: control tables of ROBOTIS XL330 and Feetech STS3215. Assumptions: the straight line from stall torque to
no-load speed of a DC motor, lowered in proportion to the torque (sag); a current loop, a filter of the velocity and a
warming of one time constant each; one sine of ripple and one of cogging; play as a dead zone, and damping of the shaft
in proportion to its speed; the order of the firmware's steps, a reading that is exact at the tick's own time, a winding
whose final temperature does not depend on the load; a resistance of the winding and a no-load speed that do not depend
on the temperature.

Of these a learned servo may have profile, encoder on the output, dead zone, clamped integral, voltage limit without
sag, current lag, asymmetry, bristles without damping, damping of the shaft, and heat (`servo_terms`). None has friction
over the position, sag, ripple, cogging, a gear that hardens or has hysteresis, ticks of the firmware, or steps of the
encoder.
"""

from __future__ import annotations

import math

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.kind import ActuatorKind
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, row_of_age, write_line

SUBSTEP = 0.0001  # Longest substep [s]
# Longest physics step [s]. Joint and gear are coupled once per step: on a bare shank (1e-4 kg·m²) some of the
# shipped motors chatter from 2 N·m of load on, since a gear that hardens is stiffer there; the walking twin shows
# none of it.
LONGEST_STEP = 0.001

# Rows of the parameters, and their number. In `ActuatorArrays` the delay is in steps, the servo period at least a
# substep, a time constant the share of the way in a substep (of the velocity filter: in a tick).
(
    KP, KD, TORQUE_LIMIT, DELAY, SERVO_PERIOD, PROFILE_SPEED, PROFILE_ACCELERATION, DEAD_ZONE, KI, INTEGRAL_LIMIT,
    OUTPUT_ENCODER, ENCODER_QUANTUM, ENCODER_ZERO, VELOCITY_FILTER, CURRENT_TIME, STALL_TORQUE, NO_LOAD_SPEED, SAG,
    HEAT_LOSS, HEAT_TIME, WARMTH, RIPPLE, RIPPLE_ORDER, RIPPLE_PHASE, COGGING, COGGING_ORDER, COGGING_PHASE, ARMATURE,
    VISCOUS_DAMPING, COULOMB, STATIC_TORQUE, STRIBECK_VELOCITY, BRISTLE_STIFFNESS, BRISTLE_DAMPING, LOAD_FRICTION,
    ASYMMETRY, POSITION_FRICTION, POSITION_ORDER, POSITION_PHASE, BACKLASH, GEAR_STIFFNESS, GEAR_HARDENING,
    GEAR_DAMPING, SLIDER_STIFFNESS, SLIDER_TORQUE, NUM_ROWS,
) = range(46)  # fmt: skip
# Rows of the memory; the delay line follows
(
    ROTOR_POS, ROTOR_VEL, REFERENCE, REFERENCE_VEL, READING, FILTERED_VEL, INTEGRAL, COMMAND, TORQUE, BRISTLE, TWIST,
    SLIDER, HEAT, WAIT, LINE,
) = range(15)  # fmt: skip


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Rotor at rest above the joint, in the middle of the backlash; the firmware's reference at the target."""
    p, memory = arrays.parameters, arrays.memory
    memory[:LINE, :] = 0.0
    for motor in range(joint_pos.shape[0]):
        memory[ROTOR_POS, motor] = joint_pos[motor]
        memory[REFERENCE, motor] = position_target[motor]
        memory[READING, motor] = _reading(p, motor, joint_pos[motor])
        memory[HEAT, motor] = p[WARMTH, motor]
    fill_line(memory, LINE, position_target)


@njit(cache=True, nogil=True)
def _clip(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))


@njit(cache=True, nogil=True)
def _dead_zone(value: float, half: float) -> float:
    return math.copysign(max(0.0, abs(value) - half), value)


@njit(cache=True, nogil=True)
def _reading(p: np.ndarray, motor: int, position: float) -> float:
    """What the encoder reads at this true angle [rad]."""
    quantum, angle = p[ENCODER_QUANTUM, motor], position + p[ENCODER_ZERO, motor]
    return quantum * math.floor(angle / quantum + 0.5) if quantum > 0.0 else angle


@njit(cache=True, nogil=True)
def _move_reference(p: np.ndarray, memory: np.ndarray, motor: int, target: float, period: float) -> None:
    """One tick of the profile; it brakes in time for the target, and lands on it."""
    fastest, a = p[PROFILE_SPEED, motor], p[PROFILE_ACCELERATION, motor]
    distance, speed = target - memory[REFERENCE, motor], memory[REFERENCE_VEL, motor]
    wish = abs(distance) / period
    if a > 0.0:
        wish = min(wish, math.sqrt(a * period * a * period + 2.0 * a * abs(distance)) - a * period)
    if fastest > 0.0:
        wish = min(wish, fastest)
    change = math.copysign(wish, distance) - speed
    speed += _clip(change, a * period) if a > 0.0 else change
    memory[REFERENCE_VEL, motor] = speed
    memory[REFERENCE, motor] += period * speed


@njit(cache=True, nogil=True)
def _tick(p: np.ndarray, memory: np.ndarray, motor: int, target: float, position: float) -> None:
    """One tick of the firmware, at which the encoder's shaft is at ``position`` [rad]."""
    period = p[SERVO_PERIOD, motor]
    if p[PROFILE_SPEED, motor] > 0.0 or p[PROFILE_ACCELERATION, motor] > 0.0:
        _move_reference(p, memory, motor, target, period)
    else:
        memory[REFERENCE, motor] = target
    reading = _reading(p, motor, position)
    velocity = (reading - memory[READING, motor]) / period
    memory[READING, motor] = reading
    memory[FILTERED_VEL, motor] += p[VELOCITY_FILTER, motor] * (velocity - memory[FILTERED_VEL, motor])
    error = _dead_zone(memory[REFERENCE, motor] - reading, p[DEAD_ZONE, motor])
    integral = memory[INTEGRAL, motor] + period * p[KI, motor] * error
    memory[INTEGRAL, motor] = _clip(integral, p[INTEGRAL_LIMIT, motor])
    law = p[KP, motor] * error + memory[INTEGRAL, motor] - p[KD, motor] * memory[FILTERED_VEL, motor]
    memory[COMMAND, motor] = _clip(law, p[TORQUE_LIMIT, motor])


@njit(cache=True, nogil=True)
def _motor(p: np.ndarray, memory: np.ndarray, motor: int) -> float:
    """Torque on the rotor [N·m]: current loop, voltage, heat, ripple, cogging."""
    x, stall, command = memory[ROTOR_POS, motor], p[STALL_TORQUE, motor], memory[COMMAND, motor]
    if stall > 0.0:
        left = max(0.0, stall - p[SAG, motor] * abs(memory[TORQUE, motor]))
        back = stall * memory[ROTOR_VEL, motor] / p[NO_LOAD_SPEED, motor]
        command = min(max(0.0, left - back), max(min(0.0, -left - back), command))
    memory[TORQUE, motor] += p[CURRENT_TIME, motor] * (command - memory[TORQUE, motor])
    memory[HEAT, motor] += p[HEAT_TIME, motor] * (1.0 - memory[HEAT, motor])
    torque = memory[TORQUE, motor] * (1.0 - p[HEAT_LOSS, motor] * memory[HEAT, motor])
    if p[RIPPLE, motor] > 0.0:
        torque *= 1.0 + p[RIPPLE, motor] * math.sin(p[RIPPLE_ORDER, motor] * x + p[RIPPLE_PHASE, motor])
    if p[COGGING, motor] > 0.0:
        torque -= p[COGGING, motor] * math.sin(p[COGGING_ORDER, motor] * x + p[COGGING_PHASE, motor])
    return torque


@njit(cache=True, nogil=True)
def _gear(p: np.ndarray, memory: np.ndarray, motor: int, twist: float, twist_vel: float) -> float:
    """Torque of the gear on the joint [N·m]: play, hardening spring, slider, damping."""
    s = _dead_zone(twist, 0.5 * p[BACKLASH, motor])
    if s == 0.0:
        memory[TWIST, motor], memory[SLIDER, motor] = 0.0, 0.0
        return 0.0
    slid = memory[SLIDER, motor] + p[SLIDER_STIFFNESS, motor] * (s - memory[TWIST, motor])
    memory[SLIDER, motor] = _clip(slid, p[SLIDER_TORQUE, motor])
    memory[TWIST, motor] = s
    torque = (p[GEAR_STIFFNESS, motor] + p[GEAR_HARDENING, motor] * s * s) * s
    torque += memory[SLIDER, motor] + p[GEAR_DAMPING, motor] * twist_vel
    return max(0.0, torque) if s > 0.0 else min(0.0, torque)


@njit(cache=True, nogil=True)
def _friction(p: np.ndarray, memory: np.ndarray, motor: int, gear: float, h: float) -> float:
    """Torque of the bristles against the rotor [N·m]."""
    w, z, stiffness = memory[ROTOR_VEL, motor], memory[BRISTLE, motor], p[BRISTLE_STIFFNESS, motor]
    ratio = w / p[STRIBECK_VELOCITY, motor]
    slow = math.exp(-ratio * ratio)
    sliding = p[COULOMB, motor] + p[STATIC_TORQUE, motor] * slow
    sliding *= 1.0 + p[ASYMMETRY, motor] * math.copysign(1.0, w)
    if p[POSITION_FRICTION, motor] > 0.0:
        angle = p[POSITION_ORDER, motor] * memory[ROTOR_POS, motor] + p[POSITION_PHASE, motor]
        sliding *= 1.0 + p[POSITION_FRICTION, motor] * math.sin(angle)
    sliding += p[LOAD_FRICTION, motor] * abs(gear)
    if stiffness <= 0.0 or sliding <= 0.0:
        memory[BRISTLE, motor] = 0.0
        return 0.0
    end = math.copysign(sliding / stiffness, w)
    rate = stiffness * abs(w) / sliding
    moved = (end - z) * -math.expm1(-rate * h)
    memory[BRISTLE, motor] = z + moved
    return stiffness * (z + moved) + p[BRISTLE_DAMPING, motor] * slow * moved / h


@njit(cache=True, nogil=True)
def _step(
    arrays: ActuatorArrays,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) mean gear torque [N·m] over the coming step; the target holds between steps."""
    p, memory = arrays.parameters, arrays.memory
    now, substeps = arrays.clock[0], arrays.clock[1]
    newest, h = write_line(memory, LINE, now, position_target), physics_dt / substeps
    for motor in range(torque.shape[0]):
        q, dq, total = joint_pos[motor], joint_vel[motor], 0.0
        on_output = p[OUTPUT_ENCODER, motor] > 0.5
        for k in range(substeps):
            x, w = memory[ROTOR_POS, motor], memory[ROTOR_VEL, motor]
            if memory[WAIT, motor] <= 1e-9:
                age = max(0, math.ceil(p[DELAY, motor] - k / substeps - 1e-9))
                target = memory[row_of_age(memory, LINE, newest, age), motor]
                since = memory[WAIT, motor]  # the tick was a part of a substep ago
                _tick(p, memory, motor, target, q + since * dq if on_output else x + since * w)
                memory[WAIT, motor] += p[SERVO_PERIOD, motor]
            memory[WAIT, motor] -= h
            gear = _gear(p, memory, motor, x - q, w - dq)
            force = _motor(p, memory, motor) - gear - _friction(p, memory, motor, gear, h)
            inverse = h / p[ARMATURE, motor]
            w = (w + inverse * force) / (1.0 + inverse * p[VISCOUS_DAMPING, motor])
            memory[ROTOR_VEL, motor] = w
            memory[ROTOR_POS, motor] = x + h * w
            q += h * dq
            total += gear
        torque[motor] = total / substeps


@njit(cache=True, nogil=True)
def _measure(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    """(n,) reading of the encoder [rad], wherever it is."""
    p = arrays.parameters
    for motor in range(out.shape[0]):
        on_output = p[OUTPUT_ENCODER, motor] > 0.5
        out[motor] = _reading(p, motor, joint_pos[motor] if on_output else arrays.memory[ROTOR_POS, motor])


FOREIGN = ActuatorKind(
    "foreign", "foreign", reset=_reset, step=_step, measure=_measure, longest_step=LONGEST_STEP,
    bench_step=SUBSTEP,
)  # fmt: skip
