"""Fit a motor prior: one network, and a mean and a log-variance of z per motor.

minimise  loss(windows, z) + kl_weight·mean_i KL(N(μ_i, σ_i²) ‖ N(0, I))
with z_i = μ_i + exp(½·log_var_i)·ε, ε ~ N(0, I), as in the paper if the preset is ``noisy``; otherwise z_i = μ_i, and
the variances are computed afterwards (`posterior`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.exceptions import MotorPriorError
from motorprior.identification.distribution import aggregate_posterior_summary
from motorprior.identification.network import Parameters, export, initial_parameters
from motorprior.identification.objectives import OBJECTIVES, kl_to_standard_normal
from motorprior.identification.posterior import standard_posterior
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData, draw

CHUNK = 100
"""Adam steps per compiled call, after which progress is reported."""
CHECKPOINT_EVERY = 5
"""Number of chunks between two checkpoints."""
Progress = Callable[[int, int, float], None]


@dataclass(frozen=True)
class Identified:
    """A trained network with the posteriors of the training motors, mean and log_var (M, Z).

    ``losses`` holds the mean loss of every CHUNK steps; ``aggregate_kl`` is the KL divergence of the mixture of all
    posteriors from N(0, I) [nat].
    """

    network: LatentNetwork
    mean: np.ndarray
    log_var: np.ndarray
    losses: np.ndarray
    aggregate_kl: float


class Checkpoints(Protocol):
    """Storage of the state from which an interrupted training continues."""

    def load(self) -> dict[str, np.ndarray] | None:
        """The last state that this training saved, or None."""
        ...

    def save(self, state: dict[str, np.ndarray]) -> None:
        """Save the state in place of the previous one."""
        ...


def identify(
    data: TrainingData,
    preset: Preset,
    seed: int,
    progress: Progress | None = None,
    checkpoints: Checkpoints | None = None,
) -> Identified:
    """Train a prior. The same data, preset and seed give the same bytes, also after an interruption.

    Raises:
        MotorPriorError: the loss became NaN or infinite.
    """
    trainable = _initial(data, preset, np.random.default_rng([seed, 0]))
    schedule = optax.warmup_cosine_decay_schedule(0.0, preset.learning_rate, min(100, preset.steps // 10), preset.steps)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    advance = _compiled_chunk(data, preset, optimiser)
    state, losses = _resume((trainable, optimiser.init(trainable)), checkpoints)
    for first in range(CHUNK * len(losses), preset.steps, CHUNK):
        count, chunk = min(CHUNK, preset.steps - first), first // CHUNK
        rows = draw(np.random.default_rng([seed, 1, chunk]), data, preset, count)
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), chunk), count)
        state, loss = advance(state, (*rows, keys))
        losses.append(_finite(float(loss), first + count))
        if checkpoints is not None and len(losses) % CHECKPOINT_EVERY == 0:
            checkpoints.save(_flat(state) | {"losses": np.asarray(losses)})
        if progress is not None:
            progress(first + count, preset.steps, losses[-1])
    trained = state[0]
    network = export(trained["network"], preset, data.scales)
    mean, log_var = (np.asarray(trained[name], np.float64) for name in ("mean", "log_var"))
    if preset.standardise:
        network, mean, log_var = standard_posterior(network, data, preset, mean)
    divergence = aggregate_posterior_summary(mean, log_var).kl if mean.size else 0.0
    return Identified(network, mean, log_var, np.asarray(losses), float(divergence))


def _initial(data: TrainingData, preset: Preset, rng: np.random.Generator) -> Parameters:
    motors, latents = len(data.series), preset.num_latents
    return {
        "network": initial_parameters(rng, preset),
        "mean": jnp.asarray(0.1 * rng.standard_normal((motors, latents)), jnp.float32),
        "log_var": jnp.full((motors, latents), -2.0, jnp.float32),  # a weak type would compile a chunk twice
    }


def _flat(state: Any) -> dict[str, np.ndarray]:
    """The arrays of a pytree, named by number."""
    return {f"leaf_{index:03d}": np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))}


def _resume(state: Any, checkpoints: Checkpoints | None) -> tuple[Any, list[float]]:
    """The initial or last saved state, and the losses of the finished chunks."""
    kept = checkpoints.load() if checkpoints is not None else None
    if kept is None:
        return state, []
    leaves = [jnp.asarray(kept[name]) for name in _flat(state)]
    return jax.tree.unflatten(jax.tree.structure(state), leaves), kept["losses"].tolist()


def _finite(loss: float, step: int) -> float:
    if not np.isfinite(loss):
        raise MotorPriorError(
            f"training diverged: the loss is {loss} at Adam step {step}",
            remedy="check the log with `motorprior logs check`, or try another seed",
        )
    return loss


def _compiled_chunk(data: TrainingData, preset: Preset, optimiser: optax.GradientTransformation):
    """Compile a function that makes one chunk of Adam steps and returns their mean loss."""
    objective = OBJECTIVES[preset.objective](preset, data.scales, data.measured, bounded=True)
    series, length = jnp.asarray(data.series), preset.history + preset.window

    def loss(trainable: Parameters, motors: jnp.ndarray, starts: jnp.ndarray, key: jax.Array) -> jnp.ndarray:
        mean, log_var, z = trainable["mean"], trainable["log_var"], trainable["mean"][motors]
        if preset.noisy:
            z = z + jnp.exp(0.5 * log_var[motors]) * jax.random.normal(key, (len(motors), preset.num_latents))
        windows = series[motors[:, None], starts[:, None] + jnp.arange(length)]
        spread = log_var if preset.noisy else jax.lax.stop_gradient(log_var)  # only noise makes the data constrain it
        kl = jnp.mean(kl_to_standard_normal(mean, spread))
        network = trainable["network"]
        if preset.per_motor:  # shared parameters stay fixed
            network = jax.lax.stop_gradient(network)
        return objective.loss(network, windows, z) + preset.kl_weight * kl

    def step(state, inputs):
        trainable, optimiser_state = state
        value, gradient = jax.value_and_grad(loss)(trainable, *inputs)
        updates, optimiser_state = optimiser.update(gradient, optimiser_state, trainable)
        return (optax.apply_updates(trainable, updates), optimiser_state), value

    @jax.jit
    def chunk(state, inputs):
        state, losses = jax.lax.scan(step, state, inputs)
        return state, jnp.mean(losses)

    return chunk
