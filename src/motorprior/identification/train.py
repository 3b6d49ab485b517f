"""Fit a motor prior: one network, and per motor a mean and a log-variance of z.

z_i = μ_i + exp(½·log_var_i)·ε,  ε ~ N(0, I)
minimise  loss(windows, z) + kl_weight·mean_i KL(N(μ_i, σ_i²) ‖ N(0, I))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.exceptions import MotorPriorError
from motorprior.identification.network import Parameters, export, initial_parameters
from motorprior.identification.objectives import OBJECTIVES, kl_to_standard_normal
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData, draw

CHUNK = 100
"""Adam steps between two reports of progress."""
Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Identified:
    """A trained network with every training motor's posterior, (M, Z) each, and the loss every CHUNK steps."""

    network: LatentNetwork
    mean: np.ndarray
    log_var: np.ndarray
    losses: np.ndarray


def identify(data: TrainingData, preset: Preset, seed: int, progress: Progress | None = None) -> Identified:
    """Train. Same data, preset and seed give the same bytes.

    Raises:
        MotorPriorError: the loss became NaN or infinite.
    """
    rng = np.random.default_rng(seed)
    motors, latents = len(data.series), preset.num_latents
    trainable = {
        "network": initial_parameters(rng, preset),
        "mean": jnp.asarray(0.1 * rng.standard_normal((motors, latents)), jnp.float32),
        "log_var": jnp.full((motors, latents), -2.0),
    }
    schedule = optax.warmup_cosine_decay_schedule(0.0, preset.learning_rate, min(100, preset.steps // 10), preset.steps)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    advance = _compiled_chunk(data, preset, optimiser)
    state, losses = (trainable, optimiser.init(trainable)), []
    key = jax.random.key(seed)
    for first in range(0, preset.steps, CHUNK):
        count = min(CHUNK, preset.steps - first)
        rows = draw(rng, data, preset, count)
        key, chunk_key = jax.random.split(key)
        state, loss = advance(state, rows, jax.random.split(chunk_key, count))
        losses.append(_finite(float(loss), first + count))
        if progress is not None:
            progress(first + count, preset.steps, losses[-1])
    trained = state[0]
    return Identified(
        export(trained["network"], preset, data.scales),
        np.asarray(trained["mean"], np.float64),
        np.asarray(trained["log_var"], np.float64),
        np.asarray(losses),
    )


def _finite(loss: float, step: int) -> float:
    if not np.isfinite(loss):
        raise MotorPriorError(
            f"training diverged: the loss is {loss} at Adam step {step}",
            remedy="check the log with `motorprior logs check`, or lower the learning rate",
        )
    return loss


def _compiled_chunk(data: TrainingData, preset: Preset, optimiser: optax.GradientTransformation):
    """A jitted function that makes one chunk of Adam steps and returns the mean loss."""
    objective = OBJECTIVES[preset.objective](preset, data.scales)
    series, length = jnp.asarray(data.series), preset.taps[-1] + preset.window

    def loss(trainable: Parameters, motors: jnp.ndarray, starts: jnp.ndarray, key: jax.Array) -> jnp.ndarray:
        mean, log_var = trainable["mean"], trainable["log_var"]
        noise = jax.random.normal(key, (len(motors), preset.num_latents))
        z = mean[motors] + jnp.exp(0.5 * log_var[motors]) * noise
        windows = series[motors[:, None], starts[:, None] + jnp.arange(length)]
        kl = jnp.mean(kl_to_standard_normal(mean, log_var))
        return objective(trainable["network"], windows, z) + preset.kl_weight * kl

    def step(state, inputs):
        trainable, optimiser_state = state
        value, gradient = jax.value_and_grad(loss)(trainable, *inputs)
        updates, optimiser_state = optimiser.update(gradient, optimiser_state, trainable)
        return (optax.apply_updates(trainable, updates), optimiser_state), value

    @jax.jit
    def chunk(state, rows, keys):
        state, losses = jax.lax.scan(step, state, (*rows, keys))
        return state, jnp.mean(losses)

    return chunk
