"""Latent networks in JAX and their objectives: the paper's torque regression, and the closed-loop rollout.

The rollout starts from the recorded state and advances as on the dynamometer; the torque depends on
the simulated history. During the warm-up before the start the model follows the recorded joint, so
that its history matches the log.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator import copula
from motorprior.actuator.latent import (
    NETWORK_SCALES,
    LatentNetwork,
    first_bias,
    log_armature,
    scaled_torque,
)
from motorprior.bench.dynamometer import next_velocity
from motorprior.identification import windows as channel
from motorprior.identification.physics.window_runs import SCALES
from motorprior.identification.presets import Recipe
from motorprior.identification.search import huber
from motorprior.identification.windows import TrainingData
from motorprior.jax_device import use_cpu_by_default

Parameters = dict[str, Any]
INITIAL_ARMATURE = 0.002  # [kg·m²]
# (parameters, windows (B, rows, channels), z (B, Z)) -> (R, B) scaled residuals
Residuals = Callable[[Parameters, jnp.ndarray, jnp.ndarray], jnp.ndarray]


def _pushed(row: jnp.ndarray, history: jnp.ndarray) -> jnp.ndarray:
    return jnp.concatenate([row[:, None], history[:, :-1]], axis=1)


def _rollout_residuals(recipe: Recipe, scales: dict[str, float], has_torque: bool) -> Residuals:
    """Simulated minus recorded positions, velocities and, if measured, torques over the free rows, over SCALES.

    Positions and velocities are those of all rows but the first, torques those that lead to them.
    """
    taps = np.asarray(recipe.taps)
    dt = recipe.period
    limit = scales["torque_limit"] / scales["torque_scale"]
    kept = recipe.taps[-1] + 1

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        own = decoder_latents(parameters, z)
        rows = jnp.swapaxes(windows, 0, 1)
        past = rows[: recipe.history]
        free = rows[recipe.history :]
        bias = first_bias(parameters, own)
        inertia = free[0, :, channel.INERTIA]
        if recipe.has_armature:
            inertia = inertia + jnp.exp(log_armature(parameters, own))

        def free_step(state, row):
            q, dq, (errors, velocities) = state  # histories (B, kept), newest first, scaled
            errors = _pushed((row[:, channel.TARGET] - q) / scales["error_scale"], errors)
            velocities = _pushed(dq / scales["velocity_scale"], velocities)
            inputs = jnp.concatenate([errors[:, taps], velocities[:, taps]], axis=1)
            torque = scales["torque_scale"] * jnp.clip(
                scaled_torque(parameters, inputs, bias), -limit, limit
            )
            external = row[:, channel.EXTERNAL] + row[:, channel.STIFFNESS] * q
            dq = next_velocity(dq, torque, external, inertia, 0.0, dt)
            q = q + dt * dq
            return (q, dq, (errors, velocities)), (q, dq, torque)

        def follow(state, rows):
            row, following = rows
            (_, _, memory), _ = free_step(state, row)
            return (following[:, channel.POS], following[:, channel.VEL], memory), None

        pos = rows[0, :, channel.POS]
        vel = rows[0, :, channel.VEL]
        first = rows[0, :, channel.TARGET]
        scaled = (first - pos) / scales["error_scale"], vel / scales["velocity_scale"]
        begin = (
            pos,
            vel,
            tuple(jnp.broadcast_to(each[:, None], (len(pos), kept)) for each in scaled),
        )
        warm, _ = jax.lax.scan(follow, begin, (past, rows[1 : recipe.history + 1]))
        _, (pos, vel, torque) = jax.lax.scan(free_step, jax.lax.stop_gradient(warm), free[:-1])
        recorded = (
            free[1:, :, channel.READING],
            free[1:, :, channel.VEL],
            free[:-1, :, channel.TORQUE],
        )
        scaled = [
            (own - log) / s
            for own, log, s in zip((pos, vel, torque), recorded, SCALES, strict=True)
        ]
        return jnp.concatenate(scaled if has_torque else scaled[:2])

    return residuals


def _torque_residuals(recipe: Recipe, scales: dict[str, float]) -> Residuals:
    """One-step errors of the torque over torque_scale."""
    taps = np.asarray(recipe.taps)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        newest = windows[:, ::-1]
        error = (newest[..., channel.TARGET] - newest[..., channel.POS]) / scales["error_scale"]
        velocity = newest[..., channel.VEL] / scales["velocity_scale"]
        inputs = jnp.concatenate([error[:, taps], velocity[:, taps]], axis=1)
        predicted = scaled_torque(
            parameters, inputs, first_bias(parameters, decoder_latents(parameters, z))
        )
        return (predicted - newest[:, 0, channel.TORQUE] / scales["torque_scale"])[None]

    return residuals


@dataclass(frozen=True)
class Objective:
    """A loss of the form weight·mean penalty(residuals)."""

    residuals: Residuals
    penalty: Callable[[jnp.ndarray], jnp.ndarray]
    weight: float

    def loss(self, parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        """Mean loss over windows (B, rows, channels) of motors with latents z (B, Z)."""
        return self.weight * jnp.mean(self.penalty(self.residuals(parameters, windows, z)))


def objective_of(recipe: Recipe, scales: dict[str, float], has_torque: bool) -> Objective:
    """The paper's loss, the mean squared one-step error of the torque over torque_scale², or that of the rollout."""
    if recipe.objective == "torque":
        return Objective(_torque_residuals(recipe, scales), jnp.square, 1.0)
    return Objective(
        _rollout_residuals(recipe, scales, has_torque), huber, 3.0 if has_torque else 2.0
    )


def initial_parameters(rng: np.random.Generator, recipe: Recipe) -> Parameters:
    """Initial parameters, float32: Glorot-scaled weights, zero biases."""

    def dense(rows: int, columns: int) -> jnp.ndarray:
        scale = 1.0 / np.sqrt(max(rows, 1))
        return jnp.asarray(scale * rng.standard_normal((rows, columns)), jnp.float32)

    inputs = 2 * len(recipe.taps)
    neurons = recipe.num_neurons
    latents = recipe.num_latents
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


def decoder_latents(parameters: Parameters, z: jnp.ndarray) -> jnp.ndarray:
    """(B, Z) decoder latents of z (B, Z); equal to z until the prior is standardised."""
    return (
        copula.decoder_latents(parameters["mixing"], parameters["quantiles"], z)
        if "mixing" in parameters
        else z
    )


def _parameters_of(network: LatentNetwork) -> Parameters:
    """The parameters, float32, of a network that `export` made."""
    names = ("w1", "v1", "b1", "w2", "b2", "w3", "b3", "log_armature", "armature_slope")
    values = {name: getattr(network, name) for name in names}
    if network.copula is not None:
        values |= {"mixing": network.copula.mixing, "quantiles": network.copula.quantiles}
    return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}


def latent_network(
    parameters: Parameters, recipe: Recipe, scales: dict[str, float]
) -> LatentNetwork:
    """The trained network, as simulations use it."""
    values: dict[str, Any] = {
        name: np.asarray(value, np.float64) for name, value in parameters.items()
    }
    values |= scales
    return LatentNetwork(
        **values, taps=recipe.taps, period=recipe.period, has_armature=recipe.has_armature
    )


_LANES = 8  # simulated at a time


class NetworkProblem:
    """Residuals of a trained network's objective on windows of M motors whose free parts do not overlap."""

    def __init__(self, network: LatentNetwork, data: TrainingData, recipe: Recipe):
        use_cpu_by_default()
        scales = tuple(float(getattr(network, name)) for name in NETWORK_SCALES)
        self._residuals, self.weight = _compiled(recipe, scales, data.has_torque)
        self._parameters = _parameters_of(network)
        length = recipe.history + recipe.window
        ahead = recipe.objective == "rollout"
        ranges = [
            range(part.start, part.stop - length - ahead + 1, recipe.window) for part in data.parts
        ]
        windows = [data.series[:, start : start + length] for starts in ranges for start in starts]
        self._windows = jnp.asarray(np.stack(windows, axis=1))
        self.count, self.observations = self._windows.shape[:2]

    def residuals(self, x: np.ndarray, which: np.ndarray) -> np.ndarray:
        """(L, windows·residuals of each) at latents x (L, Z)."""
        # whole chunks: one shape is compiled
        found = []
        padding = -len(x) % _LANES
        rows = np.pad(x, ((0, padding), (0, 0)))
        motors = np.pad(which, (0, padding))
        for first in range(0, len(rows), _LANES):
            some = slice(first, first + _LANES)
            found.append(
                np.asarray(
                    self._residuals(self._parameters, self._windows, rows[some], motors[some])
                )
            )
        return np.concatenate(found)[: len(x)].reshape(len(x), -1)


@lru_cache(maxsize=4)
def _compiled(recipe: Recipe, scales: tuple[float, ...], has_torque: bool) -> tuple[Any, float]:
    """Compiled (parameters, windows, z (L, Z), motors (L,)) -> (L, N, R) residuals, and the loss's weight."""
    objective = objective_of(recipe, dict(zip(NETWORK_SCALES, scales, strict=True)), has_torque)

    def one(
        parameters: Any, windows: jnp.ndarray, z: jnp.ndarray, motor: jnp.ndarray
    ) -> jnp.ndarray:
        own = windows[motor]
        return objective.residuals(
            parameters, own, jnp.broadcast_to(z, (own.shape[0], z.shape[0]))
        ).T

    return jax.jit(jax.vmap(one, in_axes=(None, None, 0, 0))), objective.weight
