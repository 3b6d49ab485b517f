"""The physical half of the grey-box decoder: a latent z becomes the constants of a servo, rotor and gear.

    log θ = center + zᵀ·slope            θ: the 14 PARAMETERS, kept within e^±LOG_REACH of the centre;
                                         encoder_zero = ZERO_SCALE·(center + zᵀ·slope), which may be negative

All quantities at the output shaft. The motor is advanced in substeps h of at most SUBSTEP, linearly implicit in the
rotor's velocity v', while the joint moves on at its present velocity dq:

    gear      s = twist ∓ backlash/2,  twist = rotor_pos - joint_pos;  in contact where twist + h·(v - dq) is beyond
              the play;  D = gear_damping + IMPLICITNESS·h·gear_stiffness;  τ_gear = gear_stiffness·s + D·(v' - dq)
    friction  F = coulomb + load_friction·|τ_gear| + stribeck_torque/(1 + (v/STRIBECK_VELOCITY)²)
    law       τ_law = clip(kp·(position_target(t - delay) - θ) - kd·v_filtered', ±torque_limit),
              θ = rotor_pos + h·v'/2 + encoder_zero
    rotor     armature·(v' - v)/h = τ_law - viscous_damping·v' - τ_gear - F·sign(v'),  stuck where F is enough

The joint gets torque = mean τ_gear + d·dq and damping d = share of the step in contact · (gear_damping +
step·gear_stiffness)/2 for the engine to integrate implicitly (the mean over the step, to second order in it): a stiff
gear on a light shank then stays stable. What that takes from the joint is given back to the rotor one step later, so
that momentum is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from motorprior.actuator.delay_line import delayed_target

PARAMETERS = (
    "kp", "kd_over_kp", "velocity_filter", "delay", "torque_limit", "armature", "coulomb", "stribeck_torque",
    "viscous_damping", "load_friction", "gear_stiffness", "backlash", "gear_damping", "encoder_zero",
)  # fmt: skip
"""Units as in `physical.MotorParameters`; kd_over_kp [s]."""
SUBSTEP = 0.001
"""Longest substep [s]."""
IMPLICITNESS = 0.65
"""Share of the end of a substep in the gear's spring: 0.5 is exact to second order, 1 damps most."""
LONGEST_DELAY = 0.04
"""[s]; a motor keeps its commands for so long."""
LOG_REACH = 2.5
"""A constant of a drawn motor is within a factor of 12 of the central motor's."""
ZERO_SCALE = 0.05
"""[rad]"""
STRIBECK_VELOCITY = 0.3
"""[rad/s]"""

(
    _KP, _KD, _FILTER, _DELAY, _LIMIT, _ARMATURE, _COULOMB, _STRIBECK, _VISCOUS, _LOAD_FRICTION,
    _STIFFNESS, _HALF_PLAY, _GEAR_DAMPING, _ZERO,
) = range(len(PARAMETERS))  # fmt: skip
ROTOR_POS, ROTOR_VEL, FILTERED_VEL, JOINT_VEL, DAMPING, TARGET, FORCE, CONTACT, _RING = range(9)
"""Rows of the memory; the delay line follows."""


@dataclass(frozen=True)
class GearedMotor:
    """Linear map from z to the logarithms of the constants; P = 14 parameters, Z latents."""

    center: np.ndarray
    """(P,)"""
    slope: np.ndarray
    """(Z, P)"""

    def decode(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(n,) constants by name of motors with latents z (n, Z)."""
        shift = np.einsum("nz,zp->np", z, self.slope)  # not @, whose rounding depends on the number of motors
        raw = self.center + np.clip(shift, -LOG_REACH, LOG_REACH)
        values = {name: np.exp(raw[:, row]) for row, name in enumerate(PARAMETERS)}
        values["delay"] = np.minimum(values["delay"], LONGEST_DELAY)
        values["encoder_zero"] = ZERO_SCALE * raw[:, _ZERO]
        return values


def motor_table(values: dict[str, np.ndarray], physics_dt: float) -> np.ndarray:
    """(P, n) constants as the compiled step wants them: kd, half the play, delay in steps, filter gain per substep."""
    table = np.stack([values[name] for name in PARAMETERS])
    table[_KD] = values["kp"] * values["kd_over_kp"]
    table[_DELAY] = values["delay"] / physics_dt
    table[_FILTER] = 1.0 - np.exp(-physics_dt / _substeps(physics_dt) / values["velocity_filter"])
    table[_HALF_PLAY] = 0.5 * values["backlash"]
    return table


def memory_rows(physics_dt: float) -> int:
    """Rows of the memory at this physics step [s]."""
    return _RING + math.ceil(LONGEST_DELAY / physics_dt - 1e-9) + 2


@njit(cache=True, nogil=True, inline="always")
def _substeps(physics_dt: float) -> int:
    return max(1, math.ceil(physics_dt / SUBSTEP - 1e-9))


@njit(cache=True, nogil=True)
def reset_geared_motor(memory: np.ndarray, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Rotor at rest above the joint, in the middle of the play."""
    memory[:_RING, :] = 0.0
    memory[ROTOR_POS, :] = joint_pos
    for row in range(_RING, memory.shape[0]):
        memory[row, :] = position_target


@njit(cache=True, nogil=True)
def _begin(
    p: np.ndarray, memory: np.ndarray, now: int, dt: float, position_target: np.ndarray, joint_vel: np.ndarray
) -> None:
    """Delayed targets, linear between steps; the momentum that the engine's implicit damping took from the joint."""
    ring = memory.shape[0] - _RING
    for motor in range(position_target.shape[0]):
        memory[_RING + now % ring, motor] = position_target[motor]
        memory[TARGET, motor] = delayed_target(memory, _RING, now, p[_DELAY, motor], motor)
        change = joint_vel[motor] - memory[JOINT_VEL, motor]
        memory[ROTOR_VEL, motor] += dt * memory[DAMPING, motor] * change / p[_ARMATURE, motor]
        memory[JOINT_VEL, motor] = joint_vel[motor]
        memory[FORCE, motor] = 0.0
        memory[CONTACT, motor] = 0.0


@njit(cache=True, nogil=True, inline="always")
def _rub(impulse: float, friction: float) -> float:
    """What dry friction leaves of an impulse: it can stop a rotor, never reverse it."""
    return math.copysign(max(0.0, abs(impulse) - friction), impulse)


@njit(cache=True, nogil=True)
def _substep(p: np.ndarray, memory: np.ndarray, h: float, joint_pos: np.ndarray, ahead: float) -> None:
    """Advance all rotors by ``h``; the joints are where they will be after ``ahead`` [s] of their present velocity."""
    for motor in range(joint_pos.shape[0]):
        r, v, dq = memory[ROTOR_POS, motor], memory[ROTOR_VEL, motor], memory[JOINT_VEL, motor]
        twist, half = r - joint_pos[motor] - ahead * dq, p[_HALF_PLAY, motor]
        coming = twist + h * (v - dq)
        above, below = coming > half, coming < -half
        pressed = twist - half if above else (twist + half if below else 0.0)
        contact = 1.0 if above or below else 0.0
        spring = contact * p[_STIFFNESS, motor] * pressed
        damping = contact * (p[_GEAR_DAMPING, motor] + IMPLICITNESS * h * p[_STIFFNESS, motor])
        ratio = v / STRIBECK_VELOCITY
        friction = p[_COULOMB, motor] + p[_STRIBECK, motor] / (1.0 + ratio * ratio)
        friction = h * (friction + p[_LOAD_FRICTION, motor] * abs(spring + damping * (v - dq)))
        gain, filtered = p[_FILTER, motor], memory[FILTERED_VEL, motor]
        braking = p[_KD, motor] * gain + 0.5 * h * p[_KP, motor]
        push = p[_KP, motor] * (memory[TARGET, motor] - r - p[_ZERO, motor]) - p[_KD, motor] * (1.0 - gain) * filtered
        carried = p[_ARMATURE, motor] * v + h * (damping * dq - spring)
        inertia = p[_ARMATURE, motor] + h * (p[_VISCOUS, motor] + damping)
        free = _rub(carried + h * push, friction) / (inertia + h * braking)
        law = push - braking * free
        limit = p[_LIMIT, motor]
        held = _rub(carried + h * min(limit, max(-limit, law)), friction) / inertia
        v = held if abs(law) > limit else free
        memory[FORCE, motor] += spring + damping * (v - dq)
        memory[CONTACT, motor] += contact
        memory[ROTOR_POS, motor] = r + h * v
        memory[ROTOR_VEL, motor] = v
        memory[FILTERED_VEL, motor] = filtered + gain * (v - filtered)


@njit(cache=True, nogil=True)
def step_geared_motor(
    p: np.ndarray,
    memory: np.ndarray,
    now: int,
    physics_dt: float,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
    damping: np.ndarray,
) -> None:
    """Write (n,) torque [N·m] and damping [N·m·s/rad] for the physics step that begins now.

    Args:
        p: (P, n) of `motor_table` for this step.
        memory: (rows, n) state.
        now: steps since the reset.
        physics_dt: [s].
        position_target: (n,) [rad].
        joint_pos: (n,) [rad].
        joint_vel: (n,) [rad/s].
        torque: (n,) overwritten.
        damping: (n,) overwritten.
    """
    substeps = _substeps(physics_dt)
    h = physics_dt / substeps
    _begin(p, memory, now, physics_dt, position_target, joint_vel)
    for k in range(substeps):
        _substep(p, memory, h, joint_pos, k * h)
    for motor in range(torque.shape[0]):
        touching = memory[CONTACT, motor] / substeps
        damping[motor] = 0.5 * touching * (p[_GEAR_DAMPING, motor] + physics_dt * p[_STIFFNESS, motor])
        torque[motor] = memory[FORCE, motor] / substeps + damping[motor] * joint_vel[motor]
        memory[DAMPING, motor] = damping[motor]


@njit(cache=True, nogil=True)
def read_rotor_encoders(p: np.ndarray, memory: np.ndarray, out: np.ndarray) -> None:
    """(n,) encoder angle [rad]: rotor position plus encoder zero."""
    for motor in range(out.shape[0]):
        out[motor] = memory[ROTOR_POS, motor] + p[_ZERO, motor]
