"""Loss of a motor over all windows of its log, with its derivatives, compiled once per recipe and shape.

The network's parameters are arguments, so that another prior of the same shape needs no second compilation.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.networks.network import Parameters, import_parameters
from motorprior.identification.networks.objectives import OBJECTIVES
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import Measured

LEARNING_RATE = 0.1  # Peak of Adam's cosine schedule
_SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")


class MotorLoss:
    """Compiled functions of latents z (M, Z) and windows (M, N, length, channels); U is that of `adapt`."""

    def __init__(self, preset: Preset, scales: dict[str, float], measured: Measured):
        bounded, free = (OBJECTIVES[preset.objective](preset, scales, measured, flag) for flag in (True, False))

        def loss(parameters: Parameters, z: jnp.ndarray, windows: jnp.ndarray) -> jnp.ndarray:
            return bounded.loss(parameters, windows, jnp.broadcast_to(z, (windows.shape[0], z.shape[0])))

        def energy(parameters: Parameters, z: jnp.ndarray, windows: jnp.ndarray, temperature: Any, count: Any) -> Any:
            return loss(parameters, z, windows) / temperature + 0.5 * jnp.sum(z**2) / count

        def window_loss(parameters: Parameters, z: jnp.ndarray, windows: jnp.ndarray) -> jnp.ndarray:
            return jax.vmap(lambda window: loss(parameters, z, window[None]))(windows)

        def curvatures(parameters: Parameters, z: jnp.ndarray, windows: jnp.ndarray) -> jnp.ndarray:
            return jax.lax.map(lambda one: free.gauss_newton(parameters, one[1], one[0]), (z, windows))

        def descend(parameters: Parameters, z: Any, windows: Any, picked: Any, temperature: Any, count: Any) -> Any:
            optimiser = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, len(picked)))
            slopes = jax.vmap(jax.grad(energy, argnums=1), in_axes=(None, 0, 0, None, None))

            def step(state: Any, subset: Any) -> Any:
                z, optimiser_state = state
                gradient = slopes(parameters, z, windows[:, subset], temperature, count)
                updates, optimiser_state = optimiser.update(gradient, optimiser_state)
                return (z + updates, optimiser_state), None

            return jax.lax.scan(step, (z, optimiser.init(z)), picked)[0][0]

        each, with_numbers = (None, 0, 0), (None, 0, 0, None, None)
        # of (parameters, z, windows): (M,) mean loss per window, (M, N) loss of each, (M, Z, Z) Gauss-Newton matrices
        self.losses = jax.jit(jax.vmap(loss, in_axes=each))
        self.window_losses = jax.jit(jax.vmap(window_loss, in_axes=each))
        self.curvatures = jax.jit(curvatures)
        # of (parameters, candidates (M, K, Z), windows): (M, K) mean loss of each candidate
        self.screen = jax.jit(jax.vmap(jax.vmap(loss, in_axes=(None, 0, None)), in_axes=each))
        # of (parameters, z, windows, temperature, count): (M,) U / N, and its (M, Z) gradient
        self.energies = jax.jit(jax.vmap(energy, in_axes=with_numbers))
        self.slopes = jax.jit(jax.vmap(jax.grad(energy, argnums=1), in_axes=with_numbers))
        # of (parameters, z, windows, picked (steps, batch), temperature, count): z after Adam on those windows
        self.descend = jax.jit(descend)


def motor_loss(network: LatentNetwork, preset: Preset, measured: Measured) -> tuple[MotorLoss, Parameters]:
    """The compiled functions for a network, and the network's parameters, which are their first argument."""
    scales = tuple(float(getattr(network, name)) for name in _SCALES)
    return _compiled(preset, scales, measured), import_parameters(network)


@lru_cache(maxsize=4)
def _compiled(preset: Preset, scales: tuple[float, ...], measured: Measured) -> MotorLoss:
    return MotorLoss(preset, dict(zip(_SCALES, scales, strict=True)), measured)
