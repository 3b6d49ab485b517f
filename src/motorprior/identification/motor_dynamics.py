"""The geared motor of a grey box in JAX, for training only; `actuator.geared_motor` holds the formula's other copy.

A parity test (1e-5) ties the two. Shapes: B motors side by side; constants and states are (B,).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from motorprior.actuator.geared_motor import (
    IMPLICITNESS,
    LOG_REACH,
    LONGEST_DELAY,
    PARAMETERS,
    STRIBECK_VELOCITY,
    SUBSTEP,
    ZERO_SCALE,
)
from motorprior.identification.network import Parameters

LARGEST_SENSITIVITY = 3.0
"""A window's gradient by the logarithms of its motor's constants counts at most so much: a motor that hits its end
of play a step later has gradients that say nothing, and would rule the batch."""
_ENCODER_ZERO = PARAMETERS.index("encoder_zero")

Constants = dict[str, jnp.ndarray]


class MotorState(NamedTuple):
    """What `actuator.geared_motor` keeps in its memory, without the commands."""

    rotor_pos: jnp.ndarray
    rotor_vel: jnp.ndarray
    filtered_vel: jnp.ndarray
    joint_vel: jnp.ndarray
    damping: jnp.ndarray


@jax.custom_vjp
def _bounded_gradient(raw: jnp.ndarray) -> jnp.ndarray:
    """Identity on (B, P); each row's gradient is finite and at most LARGEST_SENSITIVITY / B."""
    return raw


def _forward(raw: jnp.ndarray) -> tuple[jnp.ndarray, None]:
    return raw, None


def _backward(_: None, gradient: jnp.ndarray) -> tuple[jnp.ndarray]:
    norm = jnp.sqrt(jnp.sum(gradient**2, axis=-1, keepdims=True))
    finite, largest = jnp.isfinite(norm), LARGEST_SENSITIVITY / gradient.shape[0]
    factor = jnp.minimum(1.0, largest / jnp.maximum(jnp.where(finite, norm, 1.0), 1e-12))
    return (jnp.where(finite, gradient, 0.0) * factor,)


_bounded_gradient.defvjp(_forward, _backward)


def decode(parameters: Parameters, z: jnp.ndarray, bounded: bool) -> Constants:
    """(B,) constants by name for latents z (B, Z).

    Args:
        parameters: of the grey box.
        z: latents.
        bounded: limit what each row adds to a gradient; reverse mode only.
    """
    reach = jnp.clip(z @ parameters["motor_slope"], -LOG_REACH, LOG_REACH)
    raw = parameters["motor_center"] + reach
    raw = _bounded_gradient(raw) if bounded else raw
    values = {name: jnp.exp(raw[..., row]) for row, name in enumerate(PARAMETERS)}
    values["delay"] = jnp.minimum(values["delay"], LONGEST_DELAY)
    values["encoder_zero"] = ZERO_SCALE * raw[..., _ENCODER_ZERO]
    return values


def at_rest(joint_pos: jnp.ndarray, joint_vel: jnp.ndarray) -> MotorState:
    """Rotor above the joint and moving with it."""
    return MotorState(joint_pos, joint_vel, joint_vel, joint_vel, jnp.zeros_like(joint_pos))


def delayed(commands: jnp.ndarray, delay: jnp.ndarray, dt: float) -> jnp.ndarray:
    """(B,) position_target of ``delay`` [s] ago from commands (B, K), newest first, linear between steps."""
    ages = jnp.arange(commands.shape[1])
    weight = jnp.maximum(0.0, 1.0 - jnp.abs(delay[:, None] / dt - ages))
    return jnp.sum(weight * commands, axis=1)


def _rub(impulse: jnp.ndarray, friction: jnp.ndarray) -> jnp.ndarray:
    return jnp.sign(impulse) * jnp.maximum(jnp.abs(impulse) - friction, 0.0)


def _substep(
    motor: Constants, state: MotorState, target: jnp.ndarray, joint_pos: jnp.ndarray, h: float
) -> tuple[MotorState, jnp.ndarray, jnp.ndarray]:
    """The state after h, the gear's torque and whether it touched."""
    r, v, filtered, dq, _ = state
    twist, half = r - joint_pos, 0.5 * motor["backlash"]
    coming = twist + h * (v - dq)
    above, below = coming > half, coming < -half
    pressed = jnp.where(above, twist - half, jnp.where(below, twist + half, 0.0))
    contact = (above | below).astype(r.dtype)
    spring = contact * motor["gear_stiffness"] * pressed
    damping = contact * (motor["gear_damping"] + IMPLICITNESS * h * motor["gear_stiffness"])
    dry = motor["coulomb"] + motor["stribeck_torque"] / (1.0 + (v / STRIBECK_VELOCITY) ** 2)
    friction = h * (dry + motor["load_friction"] * jnp.abs(spring + damping * (v - dq)))
    gain, kd = 1.0 - jnp.exp(-h / motor["velocity_filter"]), motor["kp"] * motor["kd_over_kp"]
    braking = kd * gain + 0.5 * h * motor["kp"]
    push = motor["kp"] * (target - r - motor["encoder_zero"]) - kd * (1.0 - gain) * filtered
    carried = motor["armature"] * v + h * (damping * dq - spring)
    inertia = motor["armature"] + h * (motor["viscous_damping"] + damping)
    free = _rub(carried + h * push, friction) / (inertia + h * braking)
    law, limit = push - braking * free, motor["torque_limit"]
    held = _rub(carried + h * jnp.clip(law, -limit, limit), friction) / inertia
    v = jnp.where(jnp.abs(law) > limit, held, free)
    after = MotorState(r + h * v, v, filtered + gain * (v - filtered), dq, state.damping)
    return after, spring + damping * (v - dq), contact


def advance(
    motor: Constants,
    state: MotorState,
    target: jnp.ndarray,
    joint_pos: jnp.ndarray,
    joint_vel: jnp.ndarray,
    dt: float,
) -> tuple[MotorState, jnp.ndarray, jnp.ndarray]:
    """One step ``dt`` [s]: the new state, torque [N·m] and damping [N·m·s/rad] for the joint; see `geared_motor`."""
    substeps = max(1, math.ceil(dt / SUBSTEP - 1e-9))
    h = dt / substeps
    given_back = dt * state.damping * (joint_vel - state.joint_vel) / motor["armature"]
    state = state._replace(rotor_vel=state.rotor_vel + given_back, joint_vel=joint_vel)
    force, touching = jnp.zeros_like(joint_pos), jnp.zeros_like(joint_pos)
    for k in range(substeps):
        state, gear, contact = _substep(motor, state, target, joint_pos + k * h * joint_vel, h)
        force, touching = force + gear / substeps, touching + contact / substeps
    damping = 0.5 * touching * (motor["gear_damping"] + dt * motor["gear_stiffness"])
    return state._replace(damping=damping), force + damping * joint_vel, damping
