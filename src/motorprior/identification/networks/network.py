"""Parameters of a latent network in JAX, for training; `actuator.latent.scaled_torque` is the network itself."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from motorprior.actuator import copula
from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.presets import Preset

Parameters = dict[str, Any]
INITIAL_ARMATURE = 0.002  # [kg·m²]


def initial_parameters(rng: np.random.Generator, preset: Preset) -> Parameters:
    """Initial parameters, float32: Glorot-scaled weights, zero biases."""

    def dense(rows: int, columns: int) -> jnp.ndarray:
        scale = 1.0 / np.sqrt(max(rows, 1))
        return jnp.asarray(scale * rng.standard_normal((rows, columns)), jnp.float32)

    inputs, neurons, latents = 2 * len(preset.taps), preset.num_neurons, preset.num_latents
    return {
        "w1": dense(inputs, neurons), "v1": dense(latents, neurons), "b1": jnp.zeros(neurons),
        "w2": dense(neurons, neurons), "b2": jnp.zeros(neurons),
        "w3": dense(neurons, 1)[:, 0], "b3": jnp.zeros(()),
        "log_armature": jnp.asarray(np.log(INITIAL_ARMATURE), jnp.float32), "armature_slope": jnp.zeros(latents),
    }  # fmt: skip


def decoder_latents(parameters: Parameters, z: jnp.ndarray) -> jnp.ndarray:
    """(B, Z) decoder latents of z (B, Z); equal to z until the prior is standardised."""
    return copula.decoder_latents(parameters["mixing"], parameters["quantiles"], z) if "mixing" in parameters else z


def motor_bias(parameters: Parameters, z: jnp.ndarray) -> jnp.ndarray:
    """(B, H) first-layer bias of motors with latents z (B, Z)."""
    return parameters["b1"] + z @ parameters["v1"]


def armature(parameters: Parameters, z: jnp.ndarray) -> jnp.ndarray:
    """(B,) decoded armature [kg·m²]."""
    return jnp.exp(parameters["log_armature"] + z @ parameters["armature_slope"])


def import_parameters(network: LatentNetwork) -> Parameters:
    """The parameters, float32, of a network that `export` made."""
    names = ("w1", "v1", "b1", "w2", "b2", "w3", "b3", "log_armature", "armature_slope")
    values = {name: getattr(network, name) for name in names}
    if network.copula is not None:
        values |= {"mixing": network.copula.mixing, "quantiles": network.copula.quantiles}
    return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}


def export(parameters: Parameters, preset: Preset, scales: dict[str, float]) -> LatentNetwork:
    """The trained network, as simulations use it."""
    values: dict[str, Any] = {name: np.asarray(value, np.float64) for name, value in parameters.items()}
    values |= scales
    return LatentNetwork(**values, taps=preset.taps, period=preset.period, has_armature=preset.has_armature)
