"""The geared motor of a grey box in JAX, for training: a differentiable `actuator.geared_motor_step`.

Shapes: B motors in parallel; constants and states are (B,). Past commands are an array, newest first, instead of the
ring buffer of `delay_line`: JAX arrays are immutable, and so the derivative by the delay needs no lookup.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from motorprior.actuator import geared_motor_constants
from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of, step_constants
from motorprior.actuator.geared_motor_step import MotorState, array_arithmetic, step
from motorprior.actuator.servo_terms import Conditions
from motorprior.identification.networks.network import Parameters

# Bound on the norm of a window's gradient by the logarithms of its motor's constants [-]. A motor that reaches the
# end of its backlash one step later has huge and meaningless gradients, which would dominate the batch.
LARGEST_SENSITIVITY = 3.0
_ARITHMETIC = array_arithmetic(jnp)

Constants = dict[str, jnp.ndarray]


@jax.custom_vjp
def _bounded_gradient(raw: jnp.ndarray) -> jnp.ndarray:
    """Identity on (B, P) whose gradient is clipped: per row finite, of norm at most LARGEST_SENSITIVITY / B."""
    return raw


def _forward(raw: jnp.ndarray) -> tuple[jnp.ndarray, None]:
    return raw, None


def _backward(_: None, gradient: jnp.ndarray) -> tuple[jnp.ndarray]:
    norm = jnp.sqrt(jnp.sum(gradient**2, axis=-1, keepdims=True))
    finite, largest = jnp.isfinite(norm), LARGEST_SENSITIVITY / gradient.shape[0]
    factor = jnp.minimum(1.0, largest / jnp.maximum(jnp.where(finite, norm, 1.0), 1e-12))
    return (jnp.where(finite, gradient, 0.0) * factor,)


_bounded_gradient.defvjp(_forward, _backward)


def decode(
    parameters: Parameters,
    z: jnp.ndarray,
    bounded: bool,
    terms: tuple[str, ...] = (),
    seconds: jnp.ndarray | float = 0.0,
    supply: jnp.ndarray | float = 1.0,
    warmer: jnp.ndarray | float = 0.0,
) -> Constants:
    """(B,) constants by name for latents z (B, Z).

    Args:
        parameters: parameters of the grey box.
        z: latents.
        bounded: limit the gradient of each row; reverse mode only.
        terms: of the motors.
        seconds: (B,) since their cold start, for motors that warm.
        supply: (B,) supply voltage over the usual one [-].
        warmer: (B,) temperature above the usual one [K].
    """
    slope = parameters["motor_slope"]  # (P,) if each constant has a latent of its own
    raw = parameters["motor_center"] + jnp.clip(z @ slope if slope.ndim == 2 else z * slope, -LOG_REACH, LOG_REACH)
    raw, warmth = _bounded_gradient(raw) if bounded else raw, 0.0
    if "heat" in terms:
        warmth = 1.0 - jnp.exp(-seconds / jnp.exp(raw[:, parameters_of(terms).index("heat_time")]))
    return geared_motor_constants.decode(raw, jnp, terms, Conditions(warmth, supply, warmer))


def at_rest(
    target: jnp.ndarray, joint_pos: jnp.ndarray, joint_vel: jnp.ndarray, terms: tuple[str, ...] = ()
) -> MotorState:
    """State in the middle of the backlash: the rotor at the joint's angle and velocity, the profile at the target."""
    zero = jnp.zeros_like(joint_pos)
    base = MotorState(joint_pos, joint_vel, joint_vel, joint_vel, zero)
    return (
        base._replace(reference=target, reference_vel=zero, integral=zero, current=zero, bristle=zero)
        if terms
        else base
    )


def delayed(commands: jnp.ndarray, delay: jnp.ndarray, dt: float) -> jnp.ndarray:
    """(B,) position_target ``delay`` [s] ago, linearly interpolated in commands (B, K), newest first."""
    ages = jnp.arange(commands.shape[1])
    weight = jnp.maximum(0.0, 1.0 - jnp.abs(delay[:, None] / dt - ages))
    return jnp.sum(weight * commands, axis=1)


def advance(
    motor: Constants,
    state: MotorState,
    target: jnp.ndarray,
    joint_pos: jnp.ndarray,
    joint_vel: jnp.ndarray,
    dt: float,
    terms: tuple[str, ...] = (),
) -> tuple[MotorState, jnp.ndarray, jnp.ndarray]:
    """Advance one step ``dt`` [s]; returns the new state, and torque [N·m] and damping [N·m·s/rad] on the joint.

    ``target`` is the mean of the delayed command over the step.
    """
    constants = step_constants(motor, dt, jnp, terms)
    return step(constants, state, target, joint_pos, joint_vel, dt, _ARITHMETIC, terms)
