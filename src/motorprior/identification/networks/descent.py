"""Adam on random windows of the logs, restarted at a smaller learning rate where it diverges."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.exceptions import MotorPriorError
from motorprior.identification.networks import objectives
from motorprior.identification.networks.objectives import Parameters
from motorprior.identification.presets import Recipe
from motorprior.identification.windows import TrainingData
from motorprior.jax_device import use_cpu_by_default
from motorprior.progress import ReportProgress

CHUNK = 100  # Adam steps per compiled call, after which progress is reported
DIVERGED = 3.0  # loss of a diverged chunk over the lowest so far, the initial one included
# divisor of the learning rate of each restart, and number of restarts
SLOWER = 3.0
RESTARTS = 3


def train_network(
    data: TrainingData, recipe: Recipe, seed: int, report: ReportProgress
) -> tuple[LatentNetwork, np.ndarray, np.ndarray, np.ndarray]:
    """Network, means and log-variances (M, Z) of the motors' latents, and mean loss of every CHUNK steps."""
    use_cpu_by_default()
    rng = np.random.default_rng([seed, 0])
    shape = (len(data.series), recipe.num_latents)
    start = {
        "network": objectives.initial_parameters(rng, recipe),
        "mean": jnp.asarray(0.1 * rng.standard_normal(shape), jnp.float32),
        "log_var": jnp.full(shape, -2.0, jnp.float32),  # a weak type would compile a chunk twice
    }
    for restart in range(RESTARTS + 1):
        slower = replace(recipe, learning_rate=recipe.learning_rate / SLOWER**restart)
        trained, losses = _attempt(start, data, slower, seed, report)
        if trained is not None:
            mean, log_var = (np.asarray(trained[name], np.float64) for name in ("mean", "log_var"))
            return (
                objectives.latent_network(trained["network"], recipe, data.scales),
                mean,
                log_var,
                np.asarray(losses),
            )
        report(
            -CHUNK * (len(losses) - 1), f"the loss is {losses[-1]:.3g}: restarted at a lower rate"
        )
    raise MotorPriorError(
        f"training diverged, also at 1/{SLOWER**RESTARTS:.0f} of the learning rate",
        remedy="check the log with `motorprior logs check`, or try another seed",
    )


def _attempt(
    start: Parameters, data: TrainingData, recipe: Recipe, seed: int, report: ReportProgress
) -> tuple[Parameters | None, list[float]]:
    """The trained parameters, None if they diverged, and the losses of all chunks."""
    schedule = optax.warmup_cosine_decay_schedule(
        0.0, recipe.learning_rate, min(100, recipe.steps // 10), recipe.steps
    )
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    advance = _compiled_chunk(data, recipe, optimiser)
    state = (start, optimiser.init(start))
    losses = []
    lowest = np.inf
    for first in range(0, recipe.steps, CHUNK):
        count = min(CHUNK, recipe.steps - first)
        chunk = first // CHUNK
        rng = np.random.default_rng([seed, 1, chunk])
        shape = (count, recipe.batch)
        motors = rng.integers(len(data.series), size=shape)
        starts = data.starts[rng.integers(len(data.starts), size=shape)]
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), chunk), count)
        state, loss, first_loss = advance(
            state, (motors.astype(np.int32), starts.astype(np.int32), keys)
        )
        lowest = min(lowest if losses else float(first_loss), float(loss))
        losses.append(float(loss))
        if not (np.isfinite(losses[-1]) and losses[-1] <= DIVERGED * lowest):
            return None, losses
        report(count, f"loss {losses[-1]:.4f}")
    return state[0], losses


def _compiled_chunk(data: TrainingData, recipe: Recipe, optimiser: optax.GradientTransformation):
    """Compile one chunk of Adam steps, which returns state, mean loss, and the loss before the first step."""
    objective = objectives.objective_of(recipe, data.scales, data.has_torque)
    series = jnp.asarray(data.series)
    length = recipe.history + recipe.window

    def loss(
        trainable: Parameters, motors: jnp.ndarray, starts: jnp.ndarray, key: jax.Array
    ) -> jnp.ndarray:
        mean = trainable["mean"]
        log_var = trainable["log_var"]
        network = trainable["network"]
        z = mean[motors]
        if recipe.noisy:
            z = z + jnp.exp(0.5 * log_var[motors]) * jax.random.normal(
                key, (len(motors), recipe.num_latents)
            )
        windows = series[motors[:, None], starts[:, None] + jnp.arange(length)]
        # only noise makes the data constrain it
        spread = log_var if recipe.noisy else jax.lax.stop_gradient(log_var)
        # KL(N(mean, exp(log_var)) ‖ N(0, I))
        kl = 0.5 * jnp.sum(jnp.exp(spread) + mean**2 - 1.0 - spread, axis=-1)
        return objective.loss(network, windows, z) + recipe.kl_weight * jnp.mean(kl)

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
