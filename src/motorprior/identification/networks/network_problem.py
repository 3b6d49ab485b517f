"""The least-squares problems of the latents of M motors, with a trained network (`search.Problem`)."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.networks.network import import_parameters
from motorprior.identification.networks.objectives import OBJECTIVES
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import Measured, TrainingData

_SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")
_LANES = 8  # simulated at a time


class NetworkProblem:
    """Residuals of the training objective on windows that do not overlap.

    Args:
        network: trained.
        data: logs of M motors.
        preset: its recipe.
    """

    def __init__(self, network: LatentNetwork, data: TrainingData, preset: Preset):
        scales = tuple(float(getattr(network, name)) for name in _SCALES)
        self._residuals, self.weight = _compiled(preset, scales, data.measured)
        self._parameters, self._windows = import_parameters(network), jnp.asarray(tiled_windows(data, preset))
        self.count, self.observations = self._windows.shape[:2]

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, windows·residuals of each) at latents x (L, Z)."""
        found, padding = [], -len(x) % _LANES  # whole chunks: one shape is compiled
        rows, motors = np.pad(x, ((0, padding), (0, 0))), np.pad(which, (0, padding))
        for first in range(0, len(rows), _LANES):
            some = slice(first, first + _LANES)
            found.append(np.asarray(self._residuals(self._parameters, self._windows, rows[some], motors[some])))
        return np.concatenate(found)[: len(x)].reshape(len(x), -1)


def tiled_windows(data: TrainingData, preset: Preset) -> np.ndarray:
    """(M, N, length, channels) windows whose free parts do not overlap, each preceded by its history."""
    length = preset.history + preset.window
    starts, last = [], -preset.window
    for start in data.starts:
        if start >= last + preset.window or start < last:
            starts.append(int(start))
            last = int(start)
    return np.stack([data.series[:, start : start + length] for start in starts], axis=1)


@lru_cache(maxsize=4)
def _compiled(preset: Preset, scales: tuple[float, ...], measured: Measured) -> tuple[Any, float]:
    """Compiled (parameters, windows, z (L, Z), motors (L,)) -> (L, N, R) residuals, and the loss's weight."""
    objective = OBJECTIVES[preset.objective](preset, dict(zip(_SCALES, scales, strict=True)), measured)

    def one(parameters: Any, windows: jnp.ndarray, z: jnp.ndarray, motor: jnp.ndarray) -> jnp.ndarray:
        own = windows[motor]
        return objective.residuals(parameters, own, jnp.broadcast_to(z, (own.shape[0], z.shape[0]))).T

    return jax.jit(jax.vmap(one, in_axes=(None, None, 0, 0))), objective.weight
