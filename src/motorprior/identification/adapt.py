"""The posterior of z for new motors, from seconds of log, with the network as it is.

    minimise  U(z) = N·loss(z)/T + ½|z|²,     covariance = (I + N·G(z)/T)⁻¹

loss is the objective the prior was trained with, mean over N windows that do not overlap, G its Gauss-Newton matrix; T,
the prior's own loss on its training motors, makes a window that is fitted as well as theirs count as one observation
(a generalised posterior with a Laplace approximation). The descent is Adam on random subsets of the windows,
then Gauss-Newton on all.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.network import import_parameters
from motorprior.identification.objectives import OBJECTIVES
from motorprior.identification.presets import Preset
from motorprior.identification.windows import TrainingData

STEPS, LEARNING_RATE, BATCH = 300, 0.1, 16
POLISHES = 6
"""Gauss-Newton steps after the descent."""
STARTS, SCREENED_WINDOWS = 48, 24
"""Draws of each round of the search before the descent, judged by so many windows: there are many valleys."""
SEARCH_RADII = (1.0, 1.0, 0.5, 0.25, 0.12)
"""Standard deviations of the rounds' draws."""


@dataclass(frozen=True)
class Posterior:
    """Of M motors, Z latents.

    Attributes:
        mean: (M, Z).
        covariance: (M, Z, Z).
        loss: (M,) mean loss per window at the mean.
        windows: N, windows per motor.
    """

    mean: np.ndarray
    covariance: np.ndarray
    loss: np.ndarray
    windows: int


def tiled_windows(data: TrainingData, preset: Preset) -> np.ndarray:
    """(M, N, length, channels): windows whose free parts do not overlap, the history of each before it."""
    length = preset.history + preset.window
    starts, last = [], -preset.window
    for start in data.starts:
        if start >= last + preset.window or start < last:
            starts.append(int(start))
            last = int(start)
    return np.stack([data.series[:, start : start + length] for start in starts], axis=1)


def adapt(
    network: LatentNetwork, data: TrainingData, preset: Preset, temperature: float, steps: int = STEPS
) -> Posterior:
    """Posterior of every motor in ``data``, whose scales must be the network's.

    Args:
        network: of the prior.
        data: logs of the new motors, stacked.
        preset: the prior's recipe.
        temperature: T, mean window loss of the prior's training motors (`reference.reference_metrics`).
        steps: Adam steps towards the mode.
    """
    windows = jnp.asarray(tiled_windows(data, preset))
    count, loss = windows.shape[1], motor_loss(network, preset, data.has_torque)
    curvatures = _curvatures(network, preset, data.has_torque, windows)

    def energy(z: jnp.ndarray, motor_windows: jnp.ndarray) -> jnp.ndarray:
        """U(z) / N."""
        return loss(z, motor_windows) / temperature + 0.5 * jnp.sum(z**2) / count

    start = _best_starts(loss, windows, network.num_latents)
    modes = _polish(
        energy, lambda z: curvatures(z) / temperature, windows, start, _descend(energy, windows, start, steps)
    )
    losses = jax.jit(jax.vmap(loss))(modes, windows)
    covariance = _laplace(np.asarray(curvatures(modes), np.float64) * count / temperature)
    return Posterior(np.asarray(modes, np.float64), covariance, np.asarray(losses, np.float64), count)


def laplace_covariance(
    network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray, temperature: float
) -> np.ndarray:
    """(M, Z, Z) covariance of motors whose modes z (M, Z) are known; see the module."""
    windows = jnp.asarray(tiled_windows(data, preset))
    curvature = _curvatures(network, preset, data.has_torque, windows)(jnp.asarray(z, jnp.float32))
    return _laplace(np.asarray(curvature, np.float64) * windows.shape[1] / temperature)


def _curvatures(network: LatentNetwork, preset: Preset, has_torque: bool, windows: jnp.ndarray):
    """A function from z (M, Z) to the (M, Z, Z) Gauss-Newton matrices of the loss on (M, N, length, channels)."""
    parameters = import_parameters(network)
    objective = OBJECTIVES[preset.objective](preset, scales_of(network), has_torque, bounded=False)

    @jax.jit
    def curvatures(z: jnp.ndarray) -> jnp.ndarray:
        return jax.lax.map(lambda one: objective.gauss_newton(parameters, one[1], one[0]), (z, windows))

    return curvatures


def motor_loss(network: LatentNetwork, preset: Preset, has_torque: bool):
    """The objective of one motor: (z (Z,), windows (N, length, channels)) -> mean loss per window."""
    parameters = import_parameters(network)
    objective = OBJECTIVES[preset.objective](preset, scales_of(network), has_torque, bounded=True)

    def loss(z: jnp.ndarray, windows: jnp.ndarray) -> jnp.ndarray:
        return objective.loss(parameters, windows, jnp.broadcast_to(z, (windows.shape[0], z.shape[0])))

    return loss


def window_losses(network: LatentNetwork, data: TrainingData, preset: Preset, z: np.ndarray) -> np.ndarray:
    """(M, N) loss of every window that does not overlap the next, motors at latents z (M, Z)."""
    loss = motor_loss(network, preset, data.has_torque)
    windows = jnp.asarray(tiled_windows(data, preset))
    single = jax.vmap(lambda one, rows: jax.vmap(lambda row: loss(one, row[None]))(rows))
    return np.asarray(jax.jit(single)(jnp.asarray(z, jnp.float32), windows), np.float64)


def _best_starts(loss, windows: jnp.ndarray, latents: int) -> jnp.ndarray:
    """(M, Z) by random search on evenly spread windows: draws about 0, then about the best so far, ever closer."""
    rng = np.random.default_rng(0)
    picked = np.linspace(0, windows.shape[1] - 1, min(SCREENED_WINDOWS, windows.shape[1])).astype(int)
    screen = jax.jit(jax.vmap(jax.vmap(loss, in_axes=(0, None))))
    best = jnp.zeros((windows.shape[0], latents), jnp.float32)
    for radius in SEARCH_RADII:
        draws = radius * rng.standard_normal((STARTS, latents))
        draws[0] = 0.0
        candidates = best[:, None, :] + jnp.asarray(draws, jnp.float32)
        winner = jnp.argmin(screen(candidates, windows[:, picked]), axis=1)
        best = candidates[jnp.arange(len(best)), winner]
    return best


def _descend(energy, windows: jnp.ndarray, start: jnp.ndarray, steps: int) -> jnp.ndarray:
    """(M, Z) modes of all motors at once."""
    optimiser = optax.adam(optax.cosine_decay_schedule(LEARNING_RATE, steps))
    count = windows.shape[1]
    rng = np.random.default_rng(1)
    picked = np.stack([rng.permutation(count)[: min(BATCH, count)] for _ in range(steps)])

    @jax.jit
    def descend(z: jnp.ndarray) -> jnp.ndarray:
        def step(state, subset):
            z, optimiser_state = state
            gradient = jax.vmap(jax.grad(energy))(z, windows[:, subset])
            updates, optimiser_state = optimiser.update(gradient, optimiser_state)
            return (z + updates, optimiser_state), None

        (z, _), _ = jax.lax.scan(step, (z, optimiser.init(z)), jnp.asarray(picked))
        return z

    return descend(start)


def _polish(energy, curvatures, windows: jnp.ndarray, start: jnp.ndarray, found: jnp.ndarray) -> jnp.ndarray:
    """(M, Z): the better of ``start`` and ``found``, and POLISHES damped Gauss-Newton steps from there.

    A step is kept where it lowers the energy on all windows: the result is never worse than the start, whatever the
    gradients of windows say in which a motor hits its end of play.
    """
    everywhere, count = jax.jit(jax.vmap(energy)), windows.shape[1]
    slope = jax.jit(jax.vmap(jax.grad(energy)))
    values, others = everywhere(start, windows), everywhere(found, windows)
    z = jnp.where((others < values)[:, None], found, start)
    values, damping = jnp.minimum(values, others), jnp.full(len(z), 1e-2)
    identity = jnp.eye(z.shape[1])
    for _ in range(POLISHES):
        matrix = curvatures(z) + (1.0 / count + damping[:, None, None]) * identity
        candidate = z - jnp.linalg.solve(matrix, slope(z, windows)[..., None])[..., 0]
        tried = everywhere(candidate, windows)
        better = tried < values
        z, values = jnp.where(better[:, None], candidate, z), jnp.where(better, tried, values)
        damping = jnp.where(better, 0.1 * damping, 10.0 * damping)
    return z


def _laplace(precision: np.ndarray) -> np.ndarray:
    """(M, Z, Z) covariance (I + P)⁻¹, negative curvature counted as none."""
    values, vectors = np.linalg.eigh(0.5 * (precision + precision.transpose(0, 2, 1)))
    inverse = 1.0 / (1.0 + np.maximum(values, 0.0))
    return np.einsum("mij,mj,mkj->mik", vectors, inverse, vectors)


def scales_of(network: LatentNetwork) -> dict[str, float]:
    """The scales that the objectives need."""
    return {name: getattr(network, name) for name in ("error_scale", "velocity_scale", "torque_scale", "torque_limit")}
