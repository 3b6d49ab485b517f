"""Objectives of identification: the paper's torque regression, and the closed-loop rollout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import scaled_torque
from motorprior.identification.networks.closed_loop import closed_loop
from motorprior.identification.networks.network import Parameters, decoder_latents, motor_bias
from motorprior.identification.physics.window_runs import SCALES, huber, huber_curvature
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import POS, TARGET, TORQUE, VEL, Measured

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
        error = (newest[..., TARGET] - newest[..., POS]) / scales["error_scale"]
        velocity = newest[..., VEL] / scales["velocity_scale"]
        inputs = jnp.concatenate([error[:, taps], velocity[:, taps]], axis=1)
        predicted = scaled_torque(parameters, inputs, motor_bias(parameters, decoder_latents(parameters, z)))
        return (predicted - newest[:, 0, TORQUE] / scales["torque_scale"])[None]

    return Objective(residuals, jnp.square, lambda r: jnp.full_like(r, 2.0), 1.0)


def rollout_objective(preset: Preset, scales: dict[str, float], measured: Measured, bounded: bool) -> Objective:
    """The rollout loss: errors of simulated positions and velocities, and of torques if the log has them.

    ``bounded`` limits the gradient of each window; for training, in reverse mode only.
    """
    rollout = closed_loop(preset, scales, bounded, measured.at_rotor)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        errors = rollout(parameters, windows, z)
        scaled = [error / scale for error, scale in zip(errors, SCALES, strict=True)]
        return jnp.concatenate(scaled[: measured.channels])

    return Objective(residuals, huber, huber_curvature, float(measured.channels))


OBJECTIVES = {"torque": torque_objective, "rollout": rollout_objective}
