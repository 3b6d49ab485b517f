"""What identification minimises: the paper's torque regression, or the closed-loop rollout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import scaled_torque
from motorprior.identification.closed_loop import closed_loop
from motorprior.identification.network import Parameters, decoder_latents, motor_bias
from motorprior.identification.presets import Preset
from motorprior.identification.windows import POS, TARGET, TORQUE, VEL, Measured

POSITION_SCALE = 0.01
VELOCITY_SCALE = 0.3
TORQUE_SCALE = 0.3
"""Errors [rad], [rad/s], [N·m] at which the rollout loss turns from quadratic to linear."""

Residuals = Callable[[Parameters, jnp.ndarray, jnp.ndarray], jnp.ndarray]
"""(parameters, windows (B, rows, channels), z (B, Z)) -> (R, B) scaled residuals."""


@dataclass(frozen=True)
class Objective:
    """loss = weight·mean penalty(residuals).

    Attributes:
        residuals: scaled to order 1.
        penalty: of one residual.
        curvature: its second derivative.
        weight: of the mean.
    """

    residuals: Residuals
    penalty: Callable[[jnp.ndarray], jnp.ndarray]
    curvature: Callable[[jnp.ndarray], jnp.ndarray]
    weight: float

    def loss(self, parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        """Mean over windows (B, rows, channels) of motors with latents z (B, Z)."""
        return self.weight * jnp.mean(self.penalty(self.residuals(parameters, windows, z)))

    def gauss_newton(self, parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        """(Z, Z) Gauss-Newton approximation of the loss's Hessian in the one latent z (Z,) of all windows.

        weight·mean of curvature(r)·∇r·∇rᵀ: never negative, and finite where a motor sticks or reaches the end of
        its backlash.
        """

        def residuals(latent: jnp.ndarray) -> jnp.ndarray:
            return self.residuals(parameters, windows, jnp.broadcast_to(latent, (len(windows), len(latent)))).ravel()

        values, slopes = residuals(z), jax.jacfwd(residuals)(z)
        return self.weight * (slopes * self.curvature(values)[:, None]).T @ slopes / len(values)


def kl_to_standard_normal(mean: jnp.ndarray, log_var: jnp.ndarray) -> jnp.ndarray:
    """KL(N(mean, exp(log_var)) ‖ N(0, I)) = ½Σ(exp(log_var) + mean² - 1 - log_var), over the last axis."""
    return 0.5 * jnp.sum(jnp.exp(log_var) + mean**2 - 1.0 - log_var, axis=-1)


def torque_objective(preset: Preset, scales: dict[str, float], measured: Measured, bounded: bool) -> Objective:
    """Mean squared error of the torque, one step, divided by torque_scale²: the paper's loss.

    Args:
        preset: recipe.
        scales: of the inputs and the torque.
        measured: with torques, always.
        bounded: no meaning here; see `rollout_objective`.
    """
    del bounded, measured
    taps = np.asarray(preset.taps)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        newest = windows[:, ::-1]
        error = (newest[..., TARGET] - newest[..., POS]) / scales["error_scale"]
        velocity = newest[..., VEL] / scales["velocity_scale"]
        inputs = jnp.concatenate([error[:, taps], velocity[:, taps]], axis=1)
        predicted = scaled_torque(parameters, inputs, motor_bias(parameters, decoder_latents(parameters, z)))
        return (predicted - newest[:, 0, TORQUE] / scales["torque_scale"])[None]

    return Objective(residuals, jnp.square, lambda r: jnp.full_like(r, 2.0), 1.0)


def huber(x: jnp.ndarray) -> jnp.ndarray:
    """√(1 + x²) - 1: quadratic near 0, linear far out, so that one lost window does not rule a batch."""
    return jnp.sqrt(1.0 + x**2) - 1.0


def rollout_objective(preset: Preset, scales: dict[str, float], measured: Measured, bounded: bool) -> Objective:
    """Simulate the loaded joint over the window and compare positions and velocities, and torques if the log has them.

    Args:
        preset: recipe.
        scales: of the inputs and the torque.
        measured: what the windows hold.
        bounded: limit what each window adds to a gradient: for training, in reverse mode only.
    """
    rollout = closed_loop(preset, scales, bounded, measured.at_rotor)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        position, velocity, torque = rollout(parameters, windows, z)
        scaled = [position / POSITION_SCALE, velocity / VELOCITY_SCALE, torque / TORQUE_SCALE]
        return jnp.concatenate(scaled[: 3 if measured.torque else 2])

    return Objective(residuals, huber, lambda r: (1.0 + r**2) ** -1.5, 3.0 if measured.torque else 2.0)


OBJECTIVES = {"torque": torque_objective, "rollout": rollout_objective}
