"""Objectives of the networks: the paper's torque regression, and the differentiable closed-loop rollout.

The rollout starts from the recorded state and advances as on the dynamometer; the torque depends on the simulated
history. During the warm-up before the start the model follows the recorded joint, so that its history and a grey box's
hidden state (rotor, backlash, delayed commands) match the log. The grey box is `actuator.geared_motor_step` over JAX
arrays. If the log's encoders are on the rotors, the rotor follows the recording during the warm-up, with the joint
attached to it by the gear, and afterwards rotor angles are compared. Such a log identifies neither encoder_zero, which
has no effect, nor backlash, which is fixed at that of the central motor: a fit would absorb errors of the loads in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator import geared_motor_constants
from motorprior.actuator.geared_motor_constants import (
    LOG_REACH,
    MAX_DELAY,
    parameters_of,
    step_constants,
    with_logged_gains,
)
from motorprior.actuator.geared_motor_step import MotorState, array_arithmetic, initial_state, step
from motorprior.actuator.latent import scaled_torque
from motorprior.actuator.optional_terms import Conditions
from motorprior.bench.dynamometer import next_velocity
from motorprior.identification.networks.network import Parameters, armature, decoder_latents, motor_bias
from motorprior.identification.physics.window_runs import SCALES
from motorprior.identification.presets import Preset
from motorprior.identification.search import huber, huber_curvature
from motorprior.identification.training_data import windows as channel
from motorprior.identification.training_data.windows import Measured

# bound on the norm of a window's gradient with respect to the logarithms of the motor's constants [-]: gear contact one
# step earlier or later gives huge gradients, which would dominate the batch
MAX_SENSITIVITY = 3.0
_ARITHMETIC = array_arithmetic(jnp)


@jax.custom_vjp
def _bounded_gradient(raw: jnp.ndarray) -> jnp.ndarray:
    """Identity on (B, P) whose gradient is clipped: per row finite, of norm at most MAX_SENSITIVITY / B."""
    return raw


def _forward(raw: jnp.ndarray) -> tuple[jnp.ndarray, None]:
    return raw, None


def _backward(_: None, gradient: jnp.ndarray) -> tuple[jnp.ndarray]:
    norm = jnp.sqrt(jnp.sum(gradient**2, axis=-1, keepdims=True))
    finite, bound = jnp.isfinite(norm), MAX_SENSITIVITY / gradient.shape[0]
    factor = jnp.minimum(1.0, bound / jnp.maximum(jnp.where(finite, norm, 1.0), 1e-12))
    return (jnp.where(finite, gradient, 0.0) * factor,)


_bounded_gradient.defvjp(_forward, _backward)


def decode(
    parameters: Parameters,
    z: jnp.ndarray,
    bounded: bool,
    terms: tuple[str, ...] = (),
    seconds: jnp.ndarray | float = 0.0,
    supply: jnp.ndarray | float = 1.0,
    temperature_rise: jnp.ndarray | float = 0.0,
) -> dict[str, jnp.ndarray]:
    """(B,) constants by name for latents z (B, Z).

    ``bounded`` limits the gradient of each row (reverse mode only); ``seconds`` since a cold start, ``supply`` voltage
    over the nominal one [-] and ``temperature_rise``, temperature above the nominal one [K], are (B,).
    """
    slope = parameters["motor_slope"]  # (P,) if each constant has a latent of its own
    raw = parameters["motor_center"] + jnp.clip(z @ slope if slope.ndim == 2 else z * slope, -LOG_REACH, LOG_REACH)
    raw, warmth = _bounded_gradient(raw) if bounded else raw, 0.0
    if "heat" in terms:
        warmth = 1.0 - jnp.exp(-seconds / jnp.exp(raw[:, parameters_of(terms).index("heat_time")]))
    return geared_motor_constants.decode(raw, jnp, terms, Conditions(warmth, supply, temperature_rise))


def delayed(commands: jnp.ndarray, delay: jnp.ndarray, dt: float) -> jnp.ndarray:
    """(B,) position_target ``delay`` [s] ago, linearly interpolated in commands (B, K), newest first."""
    ages = jnp.arange(commands.shape[1])
    weight = jnp.maximum(0.0, 1.0 - jnp.abs(delay[:, None] / dt - ages))
    return jnp.sum(weight * commands, axis=1)


# (parameters, windows (B, rows, channels), z (B, Z)) -> errors of position, velocity and torque, each (steps, B)
Rollout = Callable[[Parameters, jnp.ndarray, jnp.ndarray], tuple[jnp.ndarray, jnp.ndarray, jnp.ndarray]]


class _Memory(NamedTuple):
    """History (B, K), newest first, of scaled errors, scaled velocities and commands [rad]; state of the grey box."""

    errors: jnp.ndarray
    velocities: jnp.ndarray
    commands: jnp.ndarray
    motor: MotorState


def _push(row: jnp.ndarray, history: jnp.ndarray) -> jnp.ndarray:
    return jnp.concatenate([row[:, None], history[:, :-1]], axis=1)


def _fill(row: jnp.ndarray, length: int) -> jnp.ndarray:
    return jnp.broadcast_to(row[:, None], (row.shape[0], length))


def closed_loop(preset: Preset, scales: dict[str, float], bounded: bool, at_rotor: bool = False) -> Rollout:
    """Build the rollout, whose errors are simulated minus recorded [rad], [rad/s], [N·m], over the free rows.

    Positions and velocities are those of all rows but the first, torques those that lead to them. ``bounded`` limits
    the gradient of each window (for training, in reverse mode). ``at_rotor``: the windows have rotor positions.
    """
    taps, dt, terms = np.asarray(preset.taps), preset.period, preset.terms
    limit = scales["torque_limit"] / scales["torque_scale"]
    at_rotor = at_rotor and preset.grey_box
    kept = max(preset.taps[-1], round(MAX_DELAY / dt) + 1) + 1

    def start(first: jnp.ndarray) -> _Memory:
        error = _fill((first[:, channel.TARGET] - first[:, channel.POS]) / scales["error_scale"], kept)
        velocity = _fill(first[:, channel.VEL] / scales["velocity_scale"], kept)
        target, pos, vel = (first[:, row] for row in (channel.TARGET, channel.POS, channel.VEL))
        state = initial_state(target, pos, vel, jnp.zeros_like(pos), bool(terms))
        return _Memory(error, velocity, _fill(first[:, channel.TARGET], kept), state)

    def actuate(parameters: Parameters, bias: Any, motor: Any, memory: _Memory, target: Any, q: Any, dq: Any):
        errors = _push((target - q) / scales["error_scale"], memory.errors)
        velocities = _push(dq / scales["velocity_scale"], memory.velocities)
        commands, state = _push(target, memory.commands), memory.motor
        inputs = jnp.concatenate([errors[:, taps], velocities[:, taps]], axis=1)
        torque = scales["torque_scale"] * jnp.clip(scaled_torque(parameters, inputs, bias), -limit, limit)
        damping = jnp.zeros_like(q)
        if preset.grey_box:
            wanted = delayed(commands, motor["delay"] + 0.5 * dt, dt)
            constants = step_constants(motor, dt, jnp, terms)
            state, gear, damping = step(constants, state, wanted, q, dq, dt, _ARITHMETIC, terms)
            torque = torque + gear
        return _Memory(errors, velocities, commands, state), torque, damping

    def rollout(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray):
        own = decoder_latents(parameters, z)
        rows = jnp.swapaxes(windows, 0, 1)
        past, free = rows[: preset.history], rows[preset.history :]
        under = (free[0, :, row] for row in (channel.SECONDS, channel.SUPPLY, channel.TEMPERATURE_RISE))
        motor = decode(parameters, own, bounded, terms, *under) if preset.grey_box else {}
        if preset.gain_unit:
            motor = with_logged_gains(motor, free[0, :, channel.KP], free[0, :, channel.KD])
        bias = motor_bias(parameters, own)
        inertia = free[0, :, channel.INERTIA]
        if preset.has_armature:
            inertia = inertia + armature(parameters, own)
        if at_rotor:
            central = decode(parameters, decoder_latents(parameters, jnp.zeros_like(z)), bounded, terms)
            motor |= {"backlash": jax.lax.stop_gradient(central["backlash"]), "encoder_zero": jnp.zeros_like(inertia)}

        def free_step(state, row):
            q, dq, memory = state
            memory, torque, damping = actuate(parameters, bias, motor, memory, row[:, channel.TARGET], q, dq)
            external = row[:, channel.EXTERNAL] + row[:, channel.STIFFNESS] * q
            dq = next_velocity(dq, torque, external, inertia, damping, dt)
            q = q + dt * dq
            measured = (memory.motor.rotor_pos, memory.motor.rotor_vel) if at_rotor else (q, dq)
            return (q, dq, memory), (*measured, torque - damping * dq)

        def follow(state, rows):
            row, following = rows
            (q, dq, memory), _ = free_step(state, row)
            if at_rotor:
                rotor = memory.motor._replace(rotor_pos=following[:, channel.POS], rotor_vel=following[:, channel.VEL])
                return (q, dq, memory._replace(motor=rotor)), None
            return (following[:, channel.POS], following[:, channel.VEL], memory), None

        begin = (rows[0, :, channel.POS], rows[0, :, channel.VEL], start(rows[0]))
        warm, _ = jax.lax.scan(follow, begin, (past, rows[1 : preset.history + 1]))
        _, (pos, vel, torque) = jax.lax.scan(free_step, jax.lax.stop_gradient(warm), free[:-1])
        return pos - free[1:, :, channel.POS], vel - free[1:, :, channel.VEL], torque - free[:-1, :, channel.TORQUE]

    return rollout


# (parameters, windows (B, rows, channels), z (B, Z)) -> (R, B) scaled residuals
Residuals = Callable[[Parameters, jnp.ndarray, jnp.ndarray], jnp.ndarray]


@dataclass(frozen=True)
class Objective:
    """A loss of the form weight·mean penalty(residuals)."""

    residuals: Residuals
    penalty: Callable[[jnp.ndarray], jnp.ndarray]
    curvature: Callable[[jnp.ndarray], jnp.ndarray]  # second derivative of the penalty
    weight: float

    def loss(self, parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        """Mean loss over windows (B, rows, channels) of motors with latents z (B, Z)."""
        return self.weight * jnp.mean(self.penalty(self.residuals(parameters, windows, z)))

    def gauss_newton(self, parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        """(Z, Z) Gauss-Newton approximation of the loss's Hessian in z (Z,), shared by all windows.

        weight·mean of curvature(r)·∇r·∇rᵀ: positive semidefinite, and finite even at stiction and gear contact.
        """

        def residuals(latent: jnp.ndarray) -> jnp.ndarray:
            return self.residuals(parameters, windows, jnp.broadcast_to(latent, (len(windows), len(latent)))).ravel()

        values, slopes = residuals(z), jax.jacfwd(residuals)(z)
        return self.weight * (slopes * self.curvature(values)[:, None]).T @ slopes / len(values)


def kl_to_standard_normal(mean: jnp.ndarray, log_var: jnp.ndarray) -> jnp.ndarray:
    """KL(N(mean, exp(log_var)) ‖ N(0, I)) = ½Σ(exp(log_var) + mean² - 1 - log_var), over the last axis."""
    return 0.5 * jnp.sum(jnp.exp(log_var) + mean**2 - 1.0 - log_var, axis=-1)


def torque_objective(preset: Preset, scales: dict[str, float], measured: Measured, bounded: bool) -> Objective:
    """The paper's loss: mean squared one-step error of the torque, divided by torque_scale²."""
    del bounded, measured
    taps = np.asarray(preset.taps)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        newest = windows[:, ::-1]
        error = (newest[..., channel.TARGET] - newest[..., channel.POS]) / scales["error_scale"]
        velocity = newest[..., channel.VEL] / scales["velocity_scale"]
        inputs = jnp.concatenate([error[:, taps], velocity[:, taps]], axis=1)
        predicted = scaled_torque(parameters, inputs, motor_bias(parameters, decoder_latents(parameters, z)))
        return (predicted - newest[:, 0, channel.TORQUE] / scales["torque_scale"])[None]

    return Objective(residuals, jnp.square, lambda r: jnp.full_like(r, 2.0), 1.0)


def rollout_objective(preset: Preset, scales: dict[str, float], measured: Measured, bounded: bool) -> Objective:
    """The rollout loss: errors of simulated positions and velocities, and of torques if the log has them."""
    rollout = closed_loop(preset, scales, bounded, measured.at_rotor)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        errors = rollout(parameters, windows, z)
        scaled = [error / scale for error, scale in zip(errors, SCALES, strict=True)]
        return jnp.concatenate(scaled[: measured.channels])

    return Objective(residuals, huber, huber_curvature, float(measured.channels))


OBJECTIVES = {"torque": torque_objective, "rollout": rollout_objective}
