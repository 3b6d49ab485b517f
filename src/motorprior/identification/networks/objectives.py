"""Latent networks in JAX and their objectives: the paper's torque regression, and the rollout.

The rollout is closed-loop: it starts from the recorded state and advances as on the dynamometer,
and the torque depends on the simulated history. During the warm-up before the start the model
follows the recorded joint, so that its history matches the log.
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
# arrays of a network that are trained
_TRAINED = ("w1", "v1", "b1", "w2", "b2", "w3", "b3", "log_armature", "armature_slope")
_LANES = 8  # simulated at a time


def _pushed(newest: jnp.ndarray, history: jnp.ndarray) -> jnp.ndarray:
    """The history (B, kept), newest first, after the values ``newest`` (B,)."""
    return jnp.concatenate([newest[:, None], history[:, :-1]], axis=1)


def _rollout_residuals(recipe: Recipe, scales: dict[str, float], has_torque: bool) -> Residuals:
    """Simulated minus recorded positions, velocities and, if measured, torques, over SCALES.

    Positions and velocities are compared in all free rows but the first, and the torques that lead
    to these rows.
    """
    taps = np.asarray(recipe.taps)
    dt = recipe.period
    limit = scales["torque_limit"] / scales["torque_scale"]
    kept = recipe.taps[-1] + 1

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        latents = decoder_latents(parameters, z)
        rows = jnp.swapaxes(windows, 0, 1)  # (rows, B, channels)
        past = rows[: recipe.history]
        free = rows[recipe.history :]
        bias = first_bias(parameters, latents)
        inertia = free[0, :, channel.INERTIA]
        if recipe.has_armature:
            inertia = inertia + jnp.exp(log_armature(parameters, latents))

        def free_step(state, row):
            q, dq, (errors, velocities) = state  # histories (B, kept), newest first, scaled
            errors = _pushed((row[:, channel.TARGET] - q) / scales["error_scale"], errors)
            velocities = _pushed(dq / scales["velocity_scale"], velocities)
            inputs = jnp.concatenate([errors[:, taps], velocities[:, taps]], axis=1)
            scaled = jnp.clip(scaled_torque(parameters, inputs, bias), -limit, limit)
            torque = scales["torque_scale"] * scaled
            external = row[:, channel.EXTERNAL] + row[:, channel.STIFFNESS] * q
            dq = next_velocity(dq, torque, external, inertia, 0.0, dt)
            q = q + dt * dq
            return (q, dq, (errors, velocities)), (q, dq, torque)

        def follow(state, rows):
            row, next_row = rows
            (_, _, memory), _ = free_step(state, row)
            return (next_row[:, channel.POS], next_row[:, channel.VEL], memory), None

        # a history that was constant before the window
        pos = rows[0, :, channel.POS]
        vel = rows[0, :, channel.VEL]
        error = (rows[0, :, channel.TARGET] - pos) / scales["error_scale"]
        histories = []
        for newest in (error, vel / scales["velocity_scale"]):
            histories.append(jnp.broadcast_to(newest[:, None], (len(pos), kept)))
        start = (pos, vel, tuple(histories))

        warm, _ = jax.lax.scan(follow, start, (past, rows[1 : recipe.history + 1]))
        _, simulated = jax.lax.scan(free_step, jax.lax.stop_gradient(warm), free[:-1])

        recorded = (
            free[1:, :, channel.READING],
            free[1:, :, channel.VEL],
            free[:-1, :, channel.TORQUE],
        )
        errors = []
        for values, logged, scale in zip(simulated, recorded, SCALES, strict=True):
            errors.append((values - logged) / scale)
        return jnp.concatenate(errors if has_torque else errors[:2])

    return residuals


def _torque_residuals(recipe: Recipe, scales: dict[str, float]) -> Residuals:
    """One-step errors of the torque over torque_scale."""
    taps = np.asarray(recipe.taps)

    def residuals(parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> jnp.ndarray:
        newest = windows[:, ::-1]
        error = (newest[..., channel.TARGET] - newest[..., channel.POS]) / scales["error_scale"]
        velocity = newest[..., channel.VEL] / scales["velocity_scale"]
        inputs = jnp.concatenate([error[:, taps], velocity[:, taps]], axis=1)
        bias = first_bias(parameters, decoder_latents(parameters, z))
        predicted = scaled_torque(parameters, inputs, bias)
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
    """Loss of the recipe.

    The paper's is the mean squared one-step error of the torque over torque_scale². The rollout's
    is the sum over channels of the mean pseudo-Huber loss of the scaled errors.
    """
    if recipe.objective == "torque":
        return Objective(_torque_residuals(recipe, scales), jnp.square, 1.0)
    num_channels = 3.0 if has_torque else 2.0
    return Objective(_rollout_residuals(recipe, scales, has_torque), huber, num_channels)


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
    if "mixing" not in parameters:
        return z
    return copula.decoder_latents(parameters["mixing"], parameters["quantiles"], z)


def _parameters_of(network: LatentNetwork) -> Parameters:
    """The parameters, float32, of a network that `latent_network` made."""
    values = {name: getattr(network, name) for name in _TRAINED}
    if network.copula is not None:
        values["mixing"] = network.copula.mixing
        values["quantiles"] = network.copula.quantiles
    return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}


def latent_network(
    parameters: Parameters, recipe: Recipe, scales: dict[str, float]
) -> LatentNetwork:
    """The trained network, as simulations use it."""
    values: dict[str, Any] = dict(scales)
    for name, value in parameters.items():
        values[name] = np.asarray(value, np.float64)
    return LatentNetwork(
        **values, taps=recipe.taps, period=recipe.period, has_armature=recipe.has_armature
    )


class NetworkProblem:
    """Residuals of a trained network's objective on windows of M motors, see `search.Problem`.

    The free parts of the windows do not overlap.
    """

    def __init__(self, network: LatentNetwork, data: TrainingData, recipe: Recipe):
        use_cpu_by_default()
        scales = tuple(float(getattr(network, name)) for name in NETWORK_SCALES)
        self._residuals, self.weight = _compiled(recipe, scales, data.has_torque)
        self._parameters = _parameters_of(network)

        # the last step of a rollout leads to one more row
        length = recipe.history + recipe.window
        needed = length + (recipe.objective == "rollout")
        windows = []
        for segment in data.segments:
            for start in range(segment.start, segment.stop - needed + 1, recipe.window):
                windows.append(data.series[:, start : start + length])
        self._windows = jnp.asarray(np.stack(windows, axis=1))
        self.count, self.observations = self._windows.shape[:2]

    def residuals(self, x: np.ndarray, problems: np.ndarray) -> np.ndarray:
        """(L, windows·residuals of each) of motor ``problems[l]`` at latents x[l], x is (L, Z)."""
        # whole chunks of lanes, so that one shape is compiled
        padding = -len(x) % _LANES
        rows = np.pad(x, ((0, padding), (0, 0)))
        motors = np.pad(problems, (0, padding))

        chunks = []
        for first in range(0, len(rows), _LANES):
            lanes = slice(first, first + _LANES)
            chunk = self._residuals(self._parameters, self._windows, rows[lanes], motors[lanes])
            chunks.append(np.asarray(chunk))
        return np.concatenate(chunks)[: len(x)].reshape(len(x), -1)


@lru_cache(maxsize=4)
def _compiled(recipe: Recipe, scales: tuple[float, ...], has_torque: bool) -> tuple[Any, float]:
    """Compiled residuals, and the weight of the loss.

    (parameters, windows, z (L, Z), motors (L,)) -> (L, N, R) residuals.
    """
    named_scales: dict[str, float] = dict(zip(NETWORK_SCALES, scales, strict=True))
    objective = objective_of(recipe, named_scales, has_torque)

    def residuals_of_motor(
        parameters: Any, windows: jnp.ndarray, z: jnp.ndarray, motor: jnp.ndarray
    ) -> jnp.ndarray:
        motor_windows = windows[motor]
        every_z = jnp.broadcast_to(z, (motor_windows.shape[0], z.shape[0]))
        return objective.residuals(parameters, motor_windows, every_z).T

    lanes = jax.vmap(residuals_of_motor, in_axes=(None, None, 0, 0))
    return jax.jit(lanes), objective.weight
