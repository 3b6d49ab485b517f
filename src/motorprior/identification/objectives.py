"""What identification minimises: the paper's torque regression, or the closed-loop rollout."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.identification.network import Parameters, armature, motor_bias, scaled_torque
from motorprior.identification.presets import Preset
from motorprior.identification.windows import EXTERNAL, INERTIA, POS, TARGET, TORQUE, VEL

POSITION_SCALE = 0.01
VELOCITY_SCALE = 0.3
"""Errors [rad], [rad/s] at which the rollout loss turns from quadratic to linear."""

Loss = Callable[[Parameters, jnp.ndarray, jnp.ndarray], jnp.ndarray]


def kl_to_standard_normal(mean: jnp.ndarray, log_var: jnp.ndarray) -> jnp.ndarray:
    """KL(N(mean, exp(log_var)) ‖ N(0, I)) = ½Σ(exp(log_var) + mean² - 1 - log_var), over the last axis."""
    return 0.5 * jnp.sum(jnp.exp(log_var) + mean**2 - 1.0 - log_var, axis=-1)


def _inputs(windows: jnp.ndarray, preset: Preset, scales: dict[str, float]) -> tuple[jnp.ndarray, jnp.ndarray]:
    """Scaled error and velocity (B, taps[-1]) before the window's first free step, newest first."""
    past = windows[:, : preset.taps[-1]][:, ::-1]
    error = (past[..., TARGET] - past[..., POS]) / scales["error_scale"]
    return error, past[..., VEL] / scales["velocity_scale"]


def torque_loss(preset: Preset, scales: dict[str, float]) -> Loss:
    """Mean squared error of the torque, one step, divided by torque_scale²: the paper's loss."""
    taps = np.asarray(preset.taps)

    def loss(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        newest = windows[:, ::-1]
        error = (newest[..., TARGET] - newest[..., POS]) / scales["error_scale"]
        velocity = newest[..., VEL] / scales["velocity_scale"]
        inputs = jnp.concatenate([error[:, taps], velocity[:, taps]], axis=1)
        predicted = scaled_torque(parameters, inputs, motor_bias(parameters, z))
        return jnp.mean((predicted - newest[:, 0, TORQUE] / scales["torque_scale"]) ** 2)

    return loss


def _huber(x: jnp.ndarray) -> jnp.ndarray:
    """√(1 + x²) - 1: quadratic near 0, linear far out, so that one lost window does not rule a batch."""
    return jnp.sqrt(1.0 + x**2) - 1.0


def rollout_loss(preset: Preset, scales: dict[str, float]) -> Loss:
    """Simulate the loaded joint over the window and compare positions and velocities.

    From the recorded state at the window's start, per step of the semi-implicit Euler

        dq += dt·(torque + external_torque)/(load_inertia + armature(z)),   q += dt·dq

    with torque from the network's own history. Needs no torque channel.
    """
    taps, dt = np.asarray(preset.taps), preset.period
    limit = scales["torque_limit"] / scales["torque_scale"]

    def loss(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        bias = motor_bias(parameters, z)
        free = jnp.swapaxes(windows[:, preset.taps[-1] :], 0, 1)
        inertia = free[0, :, INERTIA] + armature(parameters, z)
        errors, velocities = _inputs(windows, preset, scales)

        def step(state, row):
            q, dq, errors, velocities = state
            errors = jnp.concatenate([((row[:, TARGET] - q) / scales["error_scale"])[:, None], errors], axis=1)
            velocities = jnp.concatenate([(dq / scales["velocity_scale"])[:, None], velocities], axis=1)
            inputs = jnp.concatenate([errors[:, taps], velocities[:, taps]], axis=1)
            raw = scaled_torque(parameters, inputs, bias)
            torque = scales["torque_scale"] * jnp.clip(raw, -limit, limit)
            dq = dq + dt * (torque + row[:, EXTERNAL]) / inertia
            q = q + dt * dq
            return (q, dq, errors[:, :-1], velocities[:, :-1]), (q, dq)

        start = (free[0, :, POS], free[0, :, VEL], errors, velocities)
        _, (q, dq) = jax.lax.scan(step, start, free[:-1])
        position = _huber((q - free[1:, :, POS]) / POSITION_SCALE)
        velocity = _huber((dq - free[1:, :, VEL]) / VELOCITY_SCALE)
        return jnp.mean(position) + jnp.mean(velocity)

    return loss


OBJECTIVES = {"torque": torque_loss, "rollout": rollout_loss}
