"""Adam on random windows of the logs: resumable, and restarted at a smaller learning rate where it diverges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.exceptions import MotorPriorError
from motorprior.identification.networks.network import Parameters, export, initial_parameters
from motorprior.identification.networks.objectives import OBJECTIVES, kl_to_standard_normal
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import TrainingData, sample_windows

CHUNK = 100  # Adam steps per compiled call, after which progress is reported
CHECKPOINT_EVERY = 5  # chunks between two checkpoints
DIVERGED = 3.0  # loss of a diverged chunk over the lowest so far, the initial one included
SLOWER, RESTARTS = 3.0, 3  # divisor of the learning rate of each restart, and number of restarts


Report = Callable[[int, str], None]  # (steps made, text)


class Checkpoints(Protocol):
    """Storage of the state from which an interrupted training continues."""

    def load(self) -> dict[str, np.ndarray] | None:
        """The last saved state, or None."""

    def save(self, state: dict[str, np.ndarray]) -> None:
        """Replace the state."""


def train_network(
    data: TrainingData,
    preset: Preset,
    seed: int,
    report: Report = lambda steps, text: None,
    checkpoints: Checkpoints | None = None,
) -> tuple[LatentNetwork, np.ndarray, np.ndarray, np.ndarray]:
    """Network, means and log-variances (M, Z) of the motors' latents, and mean loss of every CHUNK steps."""
    rng, shape = np.random.default_rng([seed, 0]), (len(data.series), preset.num_latents)
    start = {
        "network": initial_parameters(rng, preset),
        "mean": jnp.asarray(0.1 * rng.standard_normal(shape), jnp.float32),
        "log_var": jnp.full(shape, -2.0, jnp.float32),  # a weak type would compile a chunk twice
    }
    trained, losses = descend(start, data, preset, seed, report, checkpoints)
    mean, log_var = (np.asarray(trained[name], np.float64) for name in ("mean", "log_var"))
    return export(trained["network"], preset, data.scales), mean, log_var, losses


def descend(
    trainable: Parameters,
    data: TrainingData,
    preset: Preset,
    seed: int,
    report: Report = lambda steps, text: None,
    checkpoints: Checkpoints | None = None,
) -> tuple[Parameters, np.ndarray]:
    """Train ``network``, and ``mean`` and ``log_var`` of the motors' z, from ``trainable``; resumable to the byte.

    Returns the trained parameters, and the mean loss of every CHUNK steps; raises `MotorPriorError` at the smallest
    learning rate.
    """
    kept = checkpoints.load() if checkpoints is not None else None
    first = int(kept["restart"]) if kept is not None else 0
    problem = ""
    for restart in range(first, RESTARTS + 1):
        rate = preset.learning_rate / SLOWER**restart
        slower = replace(preset, learning_rate=rate)
        trained, losses = _attempt(trainable, data, slower, seed, report, checkpoints, kept, restart)
        if trained is not None:
            return trained, np.asarray(losses)
        kept, problem = None, f"the loss is {losses[-1]:.3g} by Adam step {CHUNK * len(losses)} at a rate of {rate:.2g}"
        report(-CHUNK * (len(losses) - 1), f"{problem}: restarted at a lower rate")
    raise MotorPriorError(
        f"training diverged: {problem}, and at larger ones",
        remedy="check the log with `motorprior logs check`, or try another seed",
    )


def _attempt(
    trainable: Parameters,
    data: TrainingData,
    preset: Preset,
    seed: int,
    report: Report,
    checkpoints: Checkpoints | None,
    kept: dict[str, np.ndarray] | None,
    restart: int,
) -> tuple[Parameters | None, list[float]]:
    """The trained parameters, None if they diverged, and the losses of all chunks."""
    schedule = optax.warmup_cosine_decay_schedule(0.0, preset.learning_rate, min(100, preset.steps // 10), preset.steps)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    advance = _compiled_chunk(data, preset, optimiser)
    state, losses, before = (trainable, optimiser.init(trainable)), [], np.inf
    if kept is not None:
        leaves = [jnp.asarray(kept[name]) for name in _flat(state)]
        state = jax.tree.unflatten(jax.tree.structure(state), leaves)
        losses, before = kept["losses"].tolist(), float(kept["before"])
    for first in range(CHUNK * len(losses), preset.steps, CHUNK):
        count, chunk = min(CHUNK, preset.steps - first), first // CHUNK
        rows = sample_windows(np.random.default_rng([seed, 1, chunk]), data, preset, count)
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), chunk), count)
        state, loss, first_loss = advance(state, (*rows, keys))
        before = before if losses else float(first_loss)
        losses.append(float(loss))
        if not (np.isfinite(losses[-1]) and losses[-1] <= DIVERGED * min(before, *losses)):
            return None, losses
        if checkpoints is not None and len(losses) % CHECKPOINT_EVERY == 0:
            so_far = {"losses": losses, "restart": restart, "before": before}
            checkpoints.save(_flat(state) | {name: np.asarray(value) for name, value in so_far.items()})
        report(count, f"loss {losses[-1]:.4f}")
    return state[0], losses


def _flat(state: Any) -> dict[str, np.ndarray]:
    return {f"leaf_{index:03d}": np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))}


def _compiled_chunk(data: TrainingData, preset: Preset, optimiser: optax.GradientTransformation):
    """Compile one chunk of Adam steps, which returns state, mean loss, and the loss before the first step."""
    objective = OBJECTIVES[preset.objective](preset, data.scales, data.measured)
    series, length = jnp.asarray(data.series), preset.history + preset.window

    def loss(trainable: Parameters, motors: jnp.ndarray, starts: jnp.ndarray, key: jax.Array) -> jnp.ndarray:
        mean, log_var, network = trainable["mean"], trainable["log_var"], trainable["network"]
        z = mean[motors]
        if preset.noisy:
            z = z + jnp.exp(0.5 * log_var[motors]) * jax.random.normal(key, (len(motors), preset.num_latents))
        windows = series[motors[:, None], starts[:, None] + jnp.arange(length)]
        spread = log_var if preset.noisy else jax.lax.stop_gradient(log_var)  # only noise makes the data constrain it
        kl = jnp.mean(kl_to_standard_normal(mean, spread))
        return objective.loss(network, windows, z) + preset.kl_weight * kl

    def step(state, inputs):
        trainable, optimiser_state = state
        value, gradient = jax.value_and_grad(loss)(trainable, *inputs)
        updates, optimiser_state = optimiser.update(gradient, optimiser_state, trainable)
        return (optax.apply_updates(trainable, updates), optimiser_state), value

    @jax.jit
    def chunk(state, inputs):
        state, losses = jax.lax.scan(step, state, inputs)
        return state, jnp.mean(losses), losses[0]

    return chunk
