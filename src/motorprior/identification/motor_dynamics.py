"""The geared motor of a grey box in JAX, for training only; `actuator.geared_motor` holds the formula's other copy.

A parity test (1e-5) ties the two. Shapes: B motors side by side; constants and states are (B,).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from motorprior.actuator.geared_motor import (
    EXTRA_DAMPING,
    LOG_REACH,
    LONGEST_DELAY,
    PARAMETERS,
    RESOLVED,
    STRIBECK_VELOCITY,
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
    slope = parameters["motor_slope"]  # (P,) in a training with a latent for each constant
    raw = parameters["motor_center"] + jnp.clip(z @ slope if slope.ndim == 2 else z * slope, -LOG_REACH, LOG_REACH)
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


def advance(
    motor: Constants,
    state: MotorState,
    target: jnp.ndarray,
    joint_pos: jnp.ndarray,
    joint_vel: jnp.ndarray,
    dt: float,
) -> tuple[MotorState, jnp.ndarray, jnp.ndarray]:
    """One step ``dt`` [s]: the new state, torque [N·m] and damping [N·m·s/rad] for the joint; see `geared_motor`.

    ``target`` is the delayed command's mean over the step.
    """
    h, r, filtered, dq = dt, state.rotor_pos, state.filtered_vel, joint_vel
    v = state.rotor_vel + h * state.damping * (dq - state.joint_vel) / motor["armature"]

    twist, half_play = r - joint_pos, 0.5 * motor["backlash"]
    coming = twist + 0.5 * h * (v - dq)
    above, below = coming > half_play, coming < -half_play
    pressed = jnp.where(above, twist - half_play, jnp.where(below, twist + half_play, 0.0))
    contact = (above | below).astype(r.dtype)
    stiffness = contact * jnp.minimum(motor["gear_stiffness"], RESOLVED * motor["armature"] / h**2)
    damping = 0.5 * (contact * motor["gear_damping"] + h * stiffness)
    damper = contact * motor["gear_damping"] + EXTRA_DAMPING * h * stiffness
    gear, lead = stiffness * pressed + damper * (v - dq), damper + 0.5 * h * stiffness

    dry = motor["coulomb"] + motor["stribeck_torque"] / (1.0 + (v / STRIBECK_VELOCITY) ** 2)
    friction = h * (dry + motor["load_friction"] * jnp.abs(gear))
    steps, kd = h / motor["velocity_filter"], motor["kp"] * motor["kd_over_kp"]
    gain = -jnp.expm1(-steps)
    smoothing = 1.0 - gain / steps
    push = motor["kp"] * (target - r - motor["encoder_zero"]) - kd * (filtered + smoothing * (v - filtered))
    braking = kd * smoothing + 0.5 * h * motor["kp"]
    inertia = motor["armature"] + 0.5 * h * (lead + motor["viscous_damping"])
    carried = inertia * v - h * (gear + motor["viscous_damping"] * v)
    free = _rub(carried + h * push + 0.5 * h * braking * v, friction) / (inertia + 0.5 * h * braking)
    law, limit = push - 0.5 * braking * (free - v), motor["torque_limit"]
    held = _rub(carried + h * jnp.clip(law, -limit, limit), friction) / inertia
    after = jnp.where(jnp.abs(law) > limit, held, free)

    mean = 0.5 * (v + after)
    torque = gear + lead * (mean - v) + damping * dq
    return MotorState(r + h * after, after, filtered + gain * (mean - filtered), dq, damping), torque, damping
