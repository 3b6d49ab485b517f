"""Out-of-family motors: a second ground truth, most of whose equations are in no learned model.

All quantities are at the output shaft; x, w are position and velocity of the rotor, q, dq of the
joint, which moves at constant velocity within a step. Per substep h (<= 0.1 ms), and per tick of
the firmware, every T = servo_period:

    profile   v = clip(sqrt((a·T)² + 2·a·|d|) - a·T, ..profile_speed)·sign(d),
              at most a·T from the last v;  reference += T·v
              with d = position_target(t - delay) - reference,  a = profile_acceleration
    encoder   θ = round((x or q + encoder_zero) / encoder_quantum)·encoder_quantum,
              at the time of the tick
    velocity  u += (1 - exp(-T / velocity_filter))·((θ - θ_last) / T - u)
    control   e = deadzone(reference - θ, dead_zone),   I = clip(I + T·ki·e, ±integral_limit)
              command = clip(kp·e + I - kd·u, ±torque_limit), held until the next tick
    voltage   |command| <= stall_torque - sag·|τ| - stall_torque·w / no_load_speed
              in the driving direction
    current   τ += (1 - exp(-h / current_time))·(command - τ)
    heat      warmth += (1 - exp(-h / heat_time))·(1 - warmth)
    motor     τ_motor = τ·(1 - heat_loss·warmth)·(1 + ripple·sin(ripple_order·x + ripple_phase))
                        - cogging·sin(cogging_order·x + cogging_phase)
    gear      s = deadzone(x - q, backlash / 2)
              y = clip(y + slider_stiffness·Δs, ±slider_torque), zero in the play
              τ_gear = gear_stiffness·s + gear_hardening·s³ + y + gear_damping·(w - dq) in contact,
              never pulling
    friction  g = (coulomb + static_torque·exp(-(w / stribeck_velocity)²))·(1 + asymmetry·sign(w))
                  ·(1 + position_friction·sin(position_order·x + position_phase)) +
                  load_friction·|τ_gear|
              dz/dt = w - bristle_stiffness·|w|·z / g
              F = bristle_stiffness·z + bristle_damping·exp(-(w / stribeck_velocity)²)·dz/dt
    rotor     armature·dw/dt = τ_motor - τ_gear - F - viscous_damping·w

z is integrated exactly for the velocity at the start of the substep, which is stable for any
stiffness; viscous damping is implicit. A term is off where its first constant is 0; firmware of
period 0 ticks every substep. The joint gets the mean of τ_gear over the substeps, and the engine
applies output_damping·dq.

Sources. Friction: Canudas de Wit, Olsson, Åström and Lischinsky, A new model for control of systems
with friction, IEEE TAC 40 (1995); damping of the bristles that falls with speed, and friction that
differs by direction: Olsson et al., Friction models and friction compensation, Eur. J. Control 4
(1998); growth with the load: Bittencourt and Gunnarsson, Static friction in a robot joint, ASME J.
Dyn. Sys. 134 (2012). Friction and ripple over the position, hardening of the gear: Tuttle and
Seering, A nonlinear model of a harmonic drive gear transmission, IEEE T-RA 12 (1996). Spring and
slider: Iwan, A distributed-element model for hysteresis, J. Appl. Mech. 33 (1966), one Jenkins
element. Profile, dead zone, integral: control tables of ROBOTIS XL330 and Feetech STS3215.
Assumptions: a linear torque-speed curve of a DC motor, lowered in proportion to the torque (sag);
first-order current loop, velocity filter and warming; one sine of ripple and one of cogging; play
as a dead zone; viscous damping of the shaft; the order of the firmware's steps; encoder readings
without latency; a final winding temperature that does not depend on the load; winding resistance
and no-load speed that do not depend on the temperature.

The learned models (`optional_terms`) lack position-dependent friction, sag, ripple, cogging, a
hardening or hysteretic gear, discrete firmware ticks and encoder quantisation.
"""

import math
from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np

from motorprior.actuator.actuator import ConstantFactors, empty_arrays, require_step
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.kernels import ActuatorKind
from motorprior.actuator.physical import TrueMotors, stribeck_share, voltage_limited
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, held, write_line

SUBSTEP = 0.0001  # maximum substep [s]
# Maximum physics step [s]. Joint and gear are coupled once per step: on a bare shank (1e-4 kg·m²)
# some shipped motors chatter above 2 N·m of load, where the hardening gear is stiffer. Simulated
# walking does not reach it.
MAX_STEP = 0.001

# Rows of the parameters, and their number. In `ActuatorArrays` the delay is in steps, the servo
# period at least a substep, and a time constant the filter gain per substep (of the velocity
# filter: per tick).
(
    KP, KD, TORQUE_LIMIT, DELAY, SERVO_PERIOD, PROFILE_SPEED, PROFILE_ACCELERATION, DEAD_ZONE, KI,
    INTEGRAL_LIMIT, OUTPUT_ENCODER, ENCODER_QUANTUM, ENCODER_ZERO, VELOCITY_FILTER, CURRENT_TIME,
    STALL_TORQUE, NO_LOAD_SPEED, SAG, HEAT_LOSS, HEAT_TIME, WARMTH, RIPPLE, RIPPLE_ORDER,
    RIPPLE_PHASE, COGGING, COGGING_ORDER, COGGING_PHASE, ARMATURE, VISCOUS_DAMPING, COULOMB,
    STATIC_TORQUE, STRIBECK_VELOCITY, BRISTLE_STIFFNESS, BRISTLE_DAMPING, LOAD_FRICTION, ASYMMETRY,
    POSITION_FRICTION, POSITION_ORDER, POSITION_PHASE, BACKLASH, GEAR_STIFFNESS, GEAR_HARDENING,
    GEAR_DAMPING, SLIDER_STIFFNESS, SLIDER_TORQUE, NUM_ROWS,
) = range(46)  # fmt: skip
# rows of the memory; the delay line follows
(
    ROTOR_POS, ROTOR_VEL, REFERENCE, REFERENCE_VEL, READING, FILTERED_VEL, INTEGRAL, COMMAND,
    TORQUE, BRISTLE, TWIST, SLIDER, HEAT, WAIT, LINE,
) = range(15)  # fmt: skip


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Static rotor at the joint's angle, centred in the backlash; the reference is the target."""
    p = arrays.parameters
    memory = arrays.memory
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
    quantum = p[ENCODER_QUANTUM, motor]
    angle = position + p[ENCODER_ZERO, motor]
    return quantum * math.floor(angle / quantum + 0.5) if quantum > 0.0 else angle


@njit(cache=True, nogil=True)
def _move_reference(
    p: np.ndarray, memory: np.ndarray, motor: int, target: float, period: float
) -> None:
    """One tick of the trapezoidal profile, which stops at the target."""
    max_speed = p[PROFILE_SPEED, motor]
    a = p[PROFILE_ACCELERATION, motor]
    distance = target - memory[REFERENCE, motor]
    velocity = memory[REFERENCE_VEL, motor]

    speed = abs(distance) / period
    if a > 0.0:
        stopping = math.sqrt(a * period * a * period + 2.0 * a * abs(distance)) - a * period
        speed = min(speed, stopping)
    if max_speed > 0.0:
        speed = min(speed, max_speed)

    change = math.copysign(speed, distance) - velocity
    velocity += _clip(change, a * period) if a > 0.0 else change
    memory[REFERENCE_VEL, motor] = velocity
    memory[REFERENCE, motor] += period * velocity


@njit(cache=True, nogil=True)
def _tick(p: np.ndarray, memory: np.ndarray, motor: int, target: float, position: float) -> None:
    """One tick of the firmware, with the encoder's shaft at ``position`` [rad]."""
    period = p[SERVO_PERIOD, motor]
    if p[PROFILE_SPEED, motor] > 0.0 or p[PROFILE_ACCELERATION, motor] > 0.0:
        _move_reference(p, memory, motor, target, period)
    else:
        memory[REFERENCE, motor] = target

    reading = _reading(p, motor, position)
    velocity = (reading - memory[READING, motor]) / period
    memory[READING, motor] = reading
    memory[FILTERED_VEL, motor] += p[VELOCITY_FILTER, motor] * (
        velocity - memory[FILTERED_VEL, motor]
    )

    error = _dead_zone(memory[REFERENCE, motor] - reading, p[DEAD_ZONE, motor])
    integral = memory[INTEGRAL, motor] + period * p[KI, motor] * error
    memory[INTEGRAL, motor] = _clip(integral, p[INTEGRAL_LIMIT, motor])
    command = (
        p[KP, motor] * error + memory[INTEGRAL, motor] - p[KD, motor] * memory[FILTERED_VEL, motor]
    )
    memory[COMMAND, motor] = _clip(command, p[TORQUE_LIMIT, motor])


@njit(cache=True, nogil=True)
def _motor_torque(p: np.ndarray, memory: np.ndarray, motor: int) -> float:
    x = memory[ROTOR_POS, motor]
    stall = p[STALL_TORQUE, motor]
    command = memory[COMMAND, motor]
    if stall > 0.0:
        limit = max(0.0, stall - p[SAG, motor] * abs(memory[TORQUE, motor]))
        command = voltage_limited(
            command, limit, stall * memory[ROTOR_VEL, motor] / p[NO_LOAD_SPEED, motor]
        )

    memory[TORQUE, motor] += p[CURRENT_TIME, motor] * (command - memory[TORQUE, motor])
    memory[HEAT, motor] += p[HEAT_TIME, motor] * (1.0 - memory[HEAT, motor])
    torque = memory[TORQUE, motor] * (1.0 - p[HEAT_LOSS, motor] * memory[HEAT, motor])

    if p[RIPPLE, motor] > 0.0:
        torque *= 1.0 + p[RIPPLE, motor] * math.sin(
            p[RIPPLE_ORDER, motor] * x + p[RIPPLE_PHASE, motor]
        )
    if p[COGGING, motor] > 0.0:
        torque -= p[COGGING, motor] * math.sin(
            p[COGGING_ORDER, motor] * x + p[COGGING_PHASE, motor]
        )
    return torque


@njit(cache=True, nogil=True)
def _gear_torque(
    p: np.ndarray, memory: np.ndarray, motor: int, twist: float, twist_vel: float
) -> float:
    s = _dead_zone(twist, 0.5 * p[BACKLASH, motor])
    if s == 0.0:
        memory[TWIST, motor] = 0.0
        memory[SLIDER, motor] = 0.0
        return 0.0

    slid = memory[SLIDER, motor] + p[SLIDER_STIFFNESS, motor] * (s - memory[TWIST, motor])
    memory[SLIDER, motor] = _clip(slid, p[SLIDER_TORQUE, motor])
    memory[TWIST, motor] = s

    torque = (p[GEAR_STIFFNESS, motor] + p[GEAR_HARDENING, motor] * s * s) * s
    torque += memory[SLIDER, motor] + p[GEAR_DAMPING, motor] * twist_vel
    return max(0.0, torque) if s > 0.0 else min(0.0, torque)


@njit(cache=True, nogil=True)
def _friction(p: np.ndarray, memory: np.ndarray, motor: int, gear: float, h: float) -> float:
    w = memory[ROTOR_VEL, motor]
    z = memory[BRISTLE, motor]
    stiffness = p[BRISTLE_STIFFNESS, motor]

    # torque at which the bristles slide
    slow = stribeck_share(w, p[STRIBECK_VELOCITY, motor])
    sliding = p[COULOMB, motor] + p[STATIC_TORQUE, motor] * slow
    sliding *= 1.0 + p[ASYMMETRY, motor] * math.copysign(1.0, w)
    if p[POSITION_FRICTION, motor] > 0.0:
        angle = p[POSITION_ORDER, motor] * memory[ROTOR_POS, motor] + p[POSITION_PHASE, motor]
        sliding *= 1.0 + p[POSITION_FRICTION, motor] * math.sin(angle)
    sliding += p[LOAD_FRICTION, motor] * abs(gear)
    if stiffness <= 0.0 or sliding <= 0.0:
        memory[BRISTLE, motor] = 0.0
        return 0.0

    # deflection of the bristles, exact for a constant velocity
    end = math.copysign(sliding / stiffness, w)
    rate = stiffness * abs(w) / sliding
    moved = (end - z) * -math.expm1(-rate * h)
    memory[BRISTLE, motor] = z + moved
    return stiffness * (z + moved) + p[BRISTLE_DAMPING, motor] * slow * moved / h


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    p = arrays.parameters
    memory = arrays.memory
    now = arrays.clock[0]
    substeps = arrays.clock[1]
    newest = write_line(memory, LINE, now, position_target)
    h = physics_dt / substeps
    for motor in range(torque.shape[0]):
        q = joint_pos[motor]
        dq = joint_vel[motor]
        total = 0.0
        on_output = p[OUTPUT_ENCODER, motor] > 0.5
        for k in range(substeps):
            x = memory[ROTOR_POS, motor]
            w = memory[ROTOR_VEL, motor]
            if memory[WAIT, motor] <= 1e-9:
                target = held(memory, LINE, newest, p[DELAY, motor] - k / substeps, motor)
                since = memory[WAIT, motor]  # negative: the tick was a fraction of a substep ago
                _tick(p, memory, motor, target, q + since * dq if on_output else x + since * w)
                memory[WAIT, motor] += p[SERVO_PERIOD, motor]
            memory[WAIT, motor] -= h

            gear = _gear_torque(p, memory, motor, x - q, w - dq)
            force = _motor_torque(p, memory, motor) - gear - _friction(p, memory, motor, gear, h)

            inverse = h / p[ARMATURE, motor]
            w = (w + inverse * force) / (1.0 + inverse * p[VISCOUS_DAMPING, motor])
            memory[ROTOR_VEL, motor] = w
            memory[ROTOR_POS, motor] = x + h * w
            q += h * dq
            total += gear
        torque[motor] = total / substeps


@njit(cache=True, nogil=True)
def _read_encoders(arrays: ActuatorArrays, joint_pos: np.ndarray, out: np.ndarray) -> None:
    p = arrays.parameters
    for motor in range(out.shape[0]):
        on_output = p[OUTPUT_ENCODER, motor] > 0.5
        out[motor] = _reading(
            p, motor, joint_pos[motor] if on_output else arrays.memory[ROTOR_POS, motor]
        )


OUT_OF_FAMILY_KIND = ActuatorKind(
    "out_of_family",
    "out of family",
    reset=_reset,
    step=_step,
    read_encoders=_read_encoders,
    max_step=MAX_STEP,
    bench_step=SUBSTEP,
)


@dataclass(frozen=True)
class OutOfFamilyMotors(TrueMotors):
    """n out-of-family motors; every field has shape (n,).

    A term is off where its first constant is 0.
    """

    kind = OUT_OF_FAMILY_KIND
    # ki scales with kp, as in the learned models
    factor_names = {name: name for name in ConstantFactors._fields} | {
        "static_torque": "coulomb",
        "ki": "kp",
    }

    kp: Annotated[np.ndarray, "N·m/rad"]
    kd: Annotated[np.ndarray, "N·m·s/rad"]
    # current limit times torque constant of the cold motor
    torque_limit: Annotated[np.ndarray, "N·m"]
    delay: Annotated[np.ndarray, "s"]  # command latency
    # period of the firmware's control law; 0: every substep
    servo_period: Annotated[np.ndarray, "s"]
    profile_speed: Annotated[np.ndarray, "rad/s"]  # maximum speed of the reference; 0: no bound
    # maximum acceleration of the reference; 0: no bound
    profile_acceleration: Annotated[np.ndarray, "rad/s²"]
    dead_zone: Annotated[np.ndarray, "rad"]  # error below which kp and ki have no effect
    ki: Annotated[np.ndarray, "N·m/(rad·s)"]  # integral gain
    integral_limit: Annotated[np.ndarray, "N·m"]  # maximum integral part of the torque
    output_encoder: Annotated[np.ndarray, "1"]  # position of the encoder: 0 rotor, 1 output shaft
    encoder_quantum: Annotated[np.ndarray, "rad"]  # resolution of the encoder
    encoder_zero: Annotated[np.ndarray, "rad"]  # encoder reading at true zero
    velocity_filter: Annotated[np.ndarray, "s"]  # time constant of the velocity in the control law
    current_time: Annotated[np.ndarray, "s"]  # time constant of the current loop
    # voltage-limited torque at zero speed; 0: no voltage limit
    stall_torque: Annotated[np.ndarray, "N·m"]
    # speed at which the torque limit is zero; 0: no back-EMF
    no_load_speed: Annotated[np.ndarray, "rad/s"]
    sag: Annotated[np.ndarray, "1"]  # share of the supply voltage lost at the stall current
    heat_loss: Annotated[np.ndarray, "1"]  # relative loss of the torque constant when warm
    heat_time: Annotated[np.ndarray, "s"]  # time constant of the warming; 0: constant warmth
    warmth: Annotated[np.ndarray, "1"]  # initial warming over the final one
    ripple: Annotated[np.ndarray, "1"]  # amplitude of the torque ripple over the torque
    ripple_order: Annotated[np.ndarray, "1/rev"]  # periods per turn of the output shaft
    ripple_phase: Annotated[np.ndarray, "rad"]
    cogging: Annotated[np.ndarray, "N·m"]  # amplitude of the torque at zero current
    cogging_order: Annotated[np.ndarray, "1/rev"]  # as ripple_order
    cogging_phase: Annotated[np.ndarray, "rad"]
    armature: Annotated[np.ndarray, "kg·m²"]  # rotor inertia reflected to the output
    viscous_damping: Annotated[np.ndarray, "N·m·s/rad"]
    coulomb: Annotated[np.ndarray, "N·m"]  # sliding friction
    static_torque: Annotated[np.ndarray, "N·m"]  # static friction minus sliding friction
    # 0: friction is independent of speed, bristles have no damping
    stribeck_velocity: Annotated[np.ndarray, "rad/s"]
    bristle_stiffness: Annotated[np.ndarray, "N·m/rad"]  # presliding stiffness; 0: no dry friction
    bristle_damping: Annotated[np.ndarray, "N·m·s/rad"]  # presliding damping
    load_friction: Annotated[np.ndarray, "1"]  # friction per gear torque
    # relative increase of friction forwards, decrease backwards
    asymmetry: Annotated[np.ndarray, "1"]
    # relative amplitude of position-dependent friction
    position_friction: Annotated[np.ndarray, "1"]
    position_order: Annotated[np.ndarray, "1/rev"]  # as ripple_order
    position_phase: Annotated[np.ndarray, "rad"]
    backlash: Annotated[np.ndarray, "rad"]  # full play
    # stiffness at first contact, without the slider
    gear_stiffness: Annotated[np.ndarray, "N·m/rad"]
    gear_hardening: Annotated[np.ndarray, "N·m/rad³"]  # cubic stiffness
    gear_damping: Annotated[np.ndarray, "N·m·s/rad"]
    slider_stiffness: Annotated[np.ndarray, "N·m/rad"]  # stiffness of the spring behind the slider
    slider_torque: Annotated[np.ndarray, "N·m"]  # torque at which the slider slips
    # viscous damping of the output shaft (seals, grease)
    output_damping: Annotated[np.ndarray, "N·m·s/rad"]
    log_position_noise: Annotated[np.ndarray, "rad"]  # standard deviation of logged angles
    log_position_quantum: Annotated[np.ndarray, "rad"]  # resolution of logged angles
    # time constant of logged velocities; 0: true ones
    log_velocity_filter: Annotated[np.ndarray, "s"]
    log_velocity_noise: Annotated[np.ndarray, "rad/s"]  # standard deviation of logged velocities
    log_torque_noise: Annotated[np.ndarray, "N·m"]  # standard deviation of logged torques

    def after(self, seconds: float) -> "OutOfFamilyMotors":
        """The same motors, warmer: 1 - warmth falls by exp(-seconds / heat_time)."""
        gain = _filter_gain(seconds, self.heat_time, 0.0)
        return replace(self, warmth=self.warmth + (1.0 - self.warmth) * gain)

    def logged(
        self,
        rng: np.random.Generator,
        period: float,
        joint_pos: np.ndarray,
        joint_vel: np.ndarray,
        torque: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Recorded (steps, n) angles [rad], velocities [rad/s] and torques [N·m], with noise.

        Angles are quantised; velocities are filtered differences of the angles.
        """
        noise_of_pos, noise_of_vel, noise_of_torque = rng.standard_normal((3, *joint_pos.shape))

        angle = joint_pos + self.log_position_noise * noise_of_pos
        is_quantised = self.log_position_quantum > 0.0
        quantum = np.where(is_quantised, self.log_position_quantum, 1.0)
        angle = np.where(is_quantised, quantum * np.round(angle / quantum), angle)

        gain = _filter_gain(period, self.log_velocity_filter, 1.0)
        differences = _filtered_differences(angle, period, gain)
        velocity = np.where(self.log_velocity_filter > 0.0, differences, joint_vel)
        velocity = velocity + self.log_velocity_noise * noise_of_vel
        return angle, velocity, torque + self.log_torque_noise * noise_of_torque

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """New arrays for steps of ``physics_dt`` [s]; see `Actuator.arrays`."""
        require_step(physics_dt, MAX_STEP)
        table = np.stack([getattr(self, field.name) for field in fields(self)[:NUM_ROWS]])
        substeps = max(1, int(np.ceil(physics_dt / SUBSTEP - 1e-9)))
        h = physics_dt / substeps
        line_length = int(np.ceil(table[DELAY].max() / physics_dt)) + 2
        table[DELAY] /= physics_dt
        table[SERVO_PERIOD] = np.maximum(table[SERVO_PERIOD], h)
        table[VELOCITY_FILTER] = _filter_gain(table[SERVO_PERIOD], table[VELOCITY_FILTER], 1.0)
        table[CURRENT_TIME] = _filter_gain(h, table[CURRENT_TIME], 1.0)
        table[HEAT_TIME] = _filter_gain(h, table[HEAT_TIME], 0.0)
        table[NO_LOAD_SPEED] = np.where(table[NO_LOAD_SPEED] > 0.0, table[NO_LOAD_SPEED], np.inf)
        # 0: friction is independent of speed
        table[STRIBECK_VELOCITY] = np.maximum(table[STRIBECK_VELOCITY], 1e-9)
        rows = LINE + line_length
        return empty_arrays(OUT_OF_FAMILY_KIND, table, rows, substeps, self.output_damping)


def _filter_gain(seconds: np.ndarray | float, time_constant: np.ndarray, off: float) -> np.ndarray:
    """(n,) gain 1 - exp(-seconds / time_constant) [-] of a first-order filter.

    The gain is ``off`` where the time constant is 0.
    """
    is_on = time_constant > 0.0
    return np.where(is_on, -np.expm1(-seconds / np.where(is_on, time_constant, 1.0)), off)


def _filtered_differences(angle: np.ndarray, period: float, gain: np.ndarray) -> np.ndarray:
    raw = np.diff(angle, axis=0, prepend=angle[:1]) / period
    filtered = np.zeros_like(raw)
    for step in range(1, len(raw)):
        filtered[step] = filtered[step - 1] + gain * (raw[step] - filtered[step - 1])
    return filtered
