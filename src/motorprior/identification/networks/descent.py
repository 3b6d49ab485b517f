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
SLOWER = 3.0  # divisor of the learning rate of each restart
RESTARTS = 3
_WARM_UP_STEPS = 100  # at most


def train_network(
    data: TrainingData, recipe: Recipe, seed: int, report: ReportProgress
) -> tuple[LatentNetwork, np.ndarray, np.ndarray, np.ndarray]:
    """Train a latent network.

    Returns:
        The network, means and log-variances (M, Z) of the motors' latents, and the mean loss of
        every CHUNK steps.

    Raises:
        MotorPriorError: the training diverges, also at the lowest learning rate.
    """
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
            network = objectives.latent_network(trained["network"], recipe, data.scales)
            mean = np.asarray(trained["mean"], np.float64)
            log_var = np.asarray(trained["log_var"], np.float64)
            return network, mean, log_var, np.asarray(losses)

        # take back the work of the chunks that were reported
        work = -CHUNK * (len(losses) - 1)
        report(work, f"the loss is {losses[-1]:.3g}: restarted at a lower rate")

    raise MotorPriorError(
        f"training diverged, also at 1/{SLOWER**RESTARTS:.0f} of the learning rate",
        remedy="check the log with `motorprior logs check`, or try another seed",
    )


def _attempt(
    start: Parameters, data: TrainingData, recipe: Recipe, seed: int, report: ReportProgress
) -> tuple[Parameters | None, list[float]]:
    """The trained parameters, None if they diverged, and the losses of all chunks."""
    warm_up_steps = min(_WARM_UP_STEPS, recipe.steps // 10)
    schedule = optax.warmup_cosine_decay_schedule(
        0.0, recipe.learning_rate, warm_up_steps, recipe.steps
    )
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    advance = _compiled_chunk(data, recipe, optimiser)
    state = (start, optimiser.init(start))

    losses = []
    min_loss = np.inf
    for first in range(0, recipe.steps, CHUNK):
        # windows of random motors at random rows
        count = min(CHUNK, recipe.steps - first)
        chunk = first // CHUNK
        rng = np.random.default_rng([seed, 1, chunk])
        shape = (count, recipe.batch)
        motors = rng.integers(len(data.series), size=shape)
        starts = data.starts[rng.integers(len(data.starts), size=shape)]
        keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), chunk), count)
        inputs = (motors.astype(np.int32), starts.astype(np.int32), keys)
        state, mean_loss, first_loss = advance(state, inputs)

        loss = float(mean_loss)
        min_loss = min(min_loss if losses else float(first_loss), loss)
        losses.append(loss)
        if not (np.isfinite(loss) and loss <= DIVERGED * min_loss):
            return None, losses
        report(count, f"loss {loss:.4f}")
    return state[0], losses


def _compiled_chunk(data: TrainingData, recipe: Recipe, optimiser: optax.GradientTransformation):
    """Compile one chunk of Adam steps: (state, inputs) -> state, mean loss, and first loss.

    The first loss is that before the first step. Inputs are motors and starts (steps, batch) and
    random keys (steps,).
    """
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
            noise = jax.random.normal(key, (len(motors), recipe.num_latents))
            z = z + jnp.exp(0.5 * log_var[motors]) * noise
        windows = series[motors[:, None], starts[:, None] + jnp.arange(length)]

        # KL(N(mean, exp(log_var)) ‖ N(0, I)); only noise makes the data constrain the variance
        spread = log_var if recipe.noisy else jax.lax.stop_gradient(log_var)
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
