"""The latent network in JAX, for training only; `actuator.latent` holds the formula's other copy.

A parity test (1e-5) ties the two.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.presets import Preset

Parameters = dict[str, Any]
INITIAL_ARMATURE = 0.002
"""Start of the decoded armature [kg·m²]."""


def initial_parameters(rng: np.random.Generator, preset: Preset) -> Parameters:
    """Glorot-scaled weights, zero biases, float32."""

    def dense(rows: int, columns: int) -> jnp.ndarray:
        scale = 1.0 / np.sqrt(max(rows, 1))
        return jnp.asarray(scale * rng.standard_normal((rows, columns)), jnp.float32)

    inputs, neurons, latents = 2 * len(preset.taps), preset.num_neurons, preset.num_latents
    return {
        "w1": dense(inputs, neurons),
        "v1": dense(latents, neurons),
        "b1": jnp.zeros(neurons),
        "w2": dense(neurons, neurons),
        "b2": jnp.zeros(neurons),
        "w3": dense(neurons, 1)[:, 0],
        "b3": jnp.zeros(()),
        "log_armature": jnp.asarray(np.log(INITIAL_ARMATURE), jnp.float32),
        "armature_slope": jnp.zeros(latents),
    }


def _softsign(x: jnp.ndarray) -> jnp.ndarray:
    return x / (1.0 + jnp.abs(x))


def motor_bias(parameters: Parameters, z: jnp.ndarray) -> jnp.ndarray:
    """(B, H) first-layer bias of motors with latents z (B, Z)."""
    return parameters["b1"] + z @ parameters["v1"]


def scaled_torque(parameters: Parameters, inputs: jnp.ndarray, bias: jnp.ndarray) -> jnp.ndarray:
    """(B,) torque / torque_scale for scaled inputs (B, 2T) and first-layer bias (B, H)."""
    first = _softsign(inputs @ parameters["w1"] + bias)
    second = _softsign(first @ parameters["w2"] + parameters["b2"])
    return second @ parameters["w3"] + parameters["b3"]


def armature(parameters: Parameters, z: jnp.ndarray) -> jnp.ndarray:
    """(B,) decoded armature [kg·m²]."""
    return jnp.exp(parameters["log_armature"] + z @ parameters["armature_slope"])


def import_parameters(network: LatentNetwork) -> Parameters:
    """The pytree of a network that `export` made, float32."""
    names = ("w1", "v1", "b1", "w2", "b2", "w3", "b3", "log_armature", "armature_slope")
    return {name: jnp.asarray(getattr(network, name), jnp.float32) for name in names}


def export(parameters: Parameters, preset: Preset, scales: dict[str, float]) -> LatentNetwork:
    """The trained network for simulation."""
    values: dict[str, Any] = {name: np.asarray(value, np.float64) for name, value in parameters.items()}
    values |= scales
    return LatentNetwork(**values, taps=preset.taps, period=preset.period, has_armature=preset.has_armature)
