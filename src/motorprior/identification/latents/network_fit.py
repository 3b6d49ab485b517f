"""The posterior of z of a latent network without physics: Adam on random subsets of the windows, then Gauss-Newton.

The network's parameters are arguments of the compiled functions, which serve all priors of the same shape.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.networks.network import Parameters, import_parameters
from motorprior.identification.networks.objectives import OBJECTIVES
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import Measured, TrainingData

BATCH, LEARNING_RATE = 16, 0.1  # windows per Adam step; peak of its cosine schedule
POLISHES = 6  # Gauss-Newton steps after Adam
# random search before Adam, since U has many local minima: samples per round, windows, standard deviation per round
STARTS, SCREENED_WINDOWS, SEARCH_RADII = 48, 24, (1.0, 1.0, 0.5, 0.25, 0.12)
_SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")


def tiled_windows(data: TrainingData, preset: Preset) -> np.ndarray:
    """(M, N, length, channels) windows whose free parts do not overlap, each preceded by its history."""
    length = preset.history + preset.window
    starts, last = [], -preset.window
    for start in data.starts:
        if start >= last + preset.window or start < last:
            starts.append(int(start))
            last = int(start)
    return np.stack([data.series[:, start : start + length] for start in starts], axis=1)


class _Compiled:
    """Compiled functions of latents z (M, Z) and windows (M, N, length, channels); U is that of `latent_fit`."""

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


@lru_cache(maxsize=4)
def _compiled(preset: Preset, scales: tuple[float, ...], measured: Measured) -> _Compiled:
    return _Compiled(preset, dict(zip(_SCALES, scales, strict=True)), measured)


class NetworkFit:
    """The problem for M motors: their logs, a network, a recipe, and the temperature T."""

    def __init__(self, network: LatentNetwork, data: TrainingData, preset: Preset, temperature: float):
        scales = tuple(float(getattr(network, name)) for name in _SCALES)
        self._functions, self._parameters = _compiled(preset, scales, data.measured), import_parameters(network)
        self._windows, self._temperature = jnp.asarray(tiled_windows(data, preset)), temperature
        self._latents = network.num_latents
        self.count = self._windows.shape[1]  # N, windows per motor

    def losses(self, z: np.ndarray) -> np.ndarray:
        """(M,) mean loss per window at latents z (M, Z)."""
        return self._of(self._functions.losses, z)

    def window_losses(self, z: np.ndarray) -> np.ndarray:
        """(M, N) loss of each window at latents z (M, Z)."""
        return self._of(self._functions.window_losses, z)

    def precision(self, z: np.ndarray) -> np.ndarray:
        """(M, Z, Z) Gauss-Newton matrix N·G/T of the loss at latents z (M, Z)."""
        return self._of(self._functions.curvatures, z) * self.count / self._temperature

    def _of(self, function: Any, z: np.ndarray) -> np.ndarray:
        return np.asarray(function(self._parameters, jnp.asarray(z, jnp.float32), self._windows), np.float64)

    def mode(self, steps: int, start: np.ndarray | None) -> np.ndarray:
        """(M, Z) minimum of U, from ``start`` or a random search, with ``steps`` steps of Adam; float32."""
        first = self._best_starts() if start is None else jnp.asarray(start, jnp.float32)
        return np.asarray(self._polish(first, self._descend(first, steps)))

    def _energies(self, z: jnp.ndarray) -> jnp.ndarray:
        return self._functions.energies(self._parameters, z, self._windows, self._temperature, float(self.count))

    def _best_starts(self) -> jnp.ndarray:
        """(M, Z) best of a random search on evenly spaced windows, around the best so far with decreasing radii."""
        rng, motors = np.random.default_rng(0), self._windows.shape[0]
        picked = np.linspace(0, self.count - 1, min(SCREENED_WINDOWS, self.count)).astype(int)
        best, screened = jnp.zeros((motors, self._latents), jnp.float32), self._windows[:, picked]
        for radius in SEARCH_RADII:
            samples = radius * rng.standard_normal((STARTS, self._latents))
            samples[0] = 0.0
            candidates = best[:, None, :] + jnp.asarray(samples, jnp.float32)
            winner = jnp.argmin(self._functions.screen(self._parameters, candidates, screened), axis=1)
            best = candidates[jnp.arange(motors), winner]
        return best

    def _descend(self, start: jnp.ndarray, steps: int) -> jnp.ndarray:
        """(M, Z) latents after Adam on random subsets of the windows, the same subsets for every motor."""
        rng = np.random.default_rng(1)
        picked = np.stack([rng.permutation(self.count)[: min(BATCH, self.count)] for _ in range(steps)])
        return self._functions.descend(
            self._parameters, start, self._windows, jnp.asarray(picked), self._temperature, float(self.count)
        )

    def _polish(self, start: jnp.ndarray, found: jnp.ndarray) -> jnp.ndarray:
        """(M, Z) latents after POLISHES damped Gauss-Newton steps from the better of ``start`` and ``found``.

        A step is kept only if it lowers the energy on all windows. So the result is never worse than the start, even
        though gradients are unreliable in windows in which a motor reaches the end of its backlash.
        """
        values, others = self._energies(start), self._energies(found)
        z = jnp.where((others < values)[:, None], found, start)
        values, damping = jnp.minimum(values, others), jnp.full(len(z), 1e-2)
        identity = jnp.eye(z.shape[1])
        for _ in range(POLISHES):
            curvature = self._functions.curvatures(self._parameters, z, self._windows) / self._temperature
            matrix = curvature + (1.0 / self.count + damping[:, None, None]) * identity
            slope = self._functions.slopes(self._parameters, z, self._windows, self._temperature, float(self.count))
            candidate = z - jnp.linalg.solve(matrix, slope[..., None])[..., 0]
            tried = self._energies(candidate)
            better = tried < values
            z, values = jnp.where(better[:, None], candidate, z), jnp.where(better, tried, values)
            damping = jnp.where(better, 0.1 * damping, 10.0 * damping)
        return z
