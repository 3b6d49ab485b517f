"""A generator of joint motion, trained against a critic that distinguishes its windows from recorded ones.

Hinge loss (Lim & Ye, Geometric GAN, 2017), spectral normalisation of the critic (Miyato et al., ICLR 2018), unequal
learning rates (Heusel et al., NeurIPS 2017), and an exponential moving average of the generator's weights, which plays.
Both see bounded streams; the critic also gets joint class and gait command.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench import bounded_stream, learned_excitation
from motorprior.bench.bounded_stream import Bounds
from motorprior.bench.learned_excitation import BURN_IN, CHANNELS, LEAK, SUB, LearnedExcitation, convolved, weight_shapes
from motorprior.progress import ReportProgress

CHUNK, BATCH, HIDDEN = 25, 32, 48  # steps per compiled call; windows per step; channels of the critic
RATES = {"critic": 1e-3, "generator": 3e-4}  # learning rates of Adam, b1 = 0
DECAY = 0.995  # decay of the moving average of weights
_LAYERS, _TAPS, _STRIDE = 3, 5, 2  # convolutions of the critic
_STREAM = 53
Weights: TypeAlias = dict[str, Any]


def train_generator(
    runs: LearnedExcitation,
    steps: int,
    seed: int,
    checkpoint: Path | None = None,
    identity: Mapping[str, Any] | None = None,
    report: ReportProgress = lambda count, text: None,
) -> dict[str, np.ndarray]:
    """Weights of a generator of windows like those of ``runs``; deterministic.

    The state after every CHUNK steps is in the file ``checkpoint``; a call with the same ``identity`` continues there.
    """
    optimisers = {name: optax.adam(rate, b1=0.0, b2=0.9) for name, rate in RATES.items()}
    state, first = _initial(runs, seed, optimisers), 0
    leaves, structure = jax.tree.flatten(state)
    if checkpoint is not None and checkpoint.exists():
        tensors, header = read_tensors(checkpoint)
        if header["identity"] == identity:
            first = int(header["steps"])
            kept = [jnp.asarray(tensors[str(index)], leaf.dtype) for index, leaf in enumerate(leaves)]
            state = jax.tree.unflatten(structure, kept)
            report(first, "continued")
    advance, constants = _compiled_chunk(optimisers, len(runs.classes), runs.period), _constants(runs)
    for begin in range(first, steps, CHUNK):
        count = min(CHUNK, steps - begin)
        state, gap = advance(state, _batches(runs, np.random.default_rng([seed, _STREAM, begin]), count), constants)
        if checkpoint is not None:
            arrays = {str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))}
            write_tensors(checkpoint, arrays, {"identity": identity, "steps": begin + count})
        report(count, f"critic's gap {float(gap):.2f}")
    return {name: np.asarray(value, np.float64) for name, value in state["average"].items()}


def _initial(runs: LearnedExcitation, seed: int, optimisers: Mapping[str, Any]) -> dict[str, Any]:
    rng = np.random.default_rng([seed, _STREAM])

    def weights(shapes: Mapping[str, tuple[int, ...]]) -> Weights:
        scale = {name: 1.0 / np.sqrt(max(1, np.prod(shape[:-1]))) for name, shape in shapes.items()}
        values = {n: scale[n] * rng.standard_normal(s) * (len(s) > 1) for n, s in shapes.items()}
        return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}

    given = CHANNELS + 2 + SUB + len(runs.classes) + 1
    sizes = (given, *(HIDDEN for _ in range(_LAYERS)))
    shapes: dict[str, tuple[int, ...]] = {"out": (3 * HIDDEN, 1)}
    for layer, size in enumerate(sizes[:-1]):
        shapes |= {f"k{layer}": (_TAPS, size, HIDDEN), f"c{layer}": (HIDDEN,)}
    making, critic = weights(weight_shapes(len(runs.classes))), weights(shapes)
    directions = {n: jnp.asarray(rng.standard_normal(s[-1]), jnp.float32) for n, s in shapes.items() if len(s) > 1}
    return {
        "generator": making, "critic": critic, "average": making, "directions": directions,
        **{f"{name}_adam": optimisers[name].init(own) for name, own in (("generator", making), ("critic", critic))},
    }  # fmt: skip


def _batches(runs: LearnedExcitation, rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """For ``count`` steps and twice a BATCH: inputs of the generator, classes, commands, and real windows."""
    which = rng.integers(len(runs.classes), size=count * 2 * BATCH)
    frames = runs.windows.shape[1] + BURN_IN + learned_excitation.RECEPTIVE
    inputs, chosen = learned_excitation.generator_inputs(runs, rng, frames, which, style_frames=frames)
    parts = inputs, which, runs.commands[chosen], runs.windows[chosen] / runs.scales[which][:, None]
    # JAX makes them float32 and int32
    return tuple(part.reshape(count, 2, BATCH, *part.shape[1:]) for part in parts)


def _constants(runs: LearnedExcitation) -> tuple[jnp.ndarray, ...]:
    """Of each class: bounds, scales, and standard deviations of the critic's `_derivatives` of scaled windows."""
    own = [runs.windows[runs.window_class == kind] / scales for kind, scales in enumerate(runs.scales)]
    parts = [[np.std(part) for part in _derivatives(windows, np)] for windows in own]
    return tuple(jnp.asarray(value, jnp.float32) for value in (runs.bounds, runs.scales, np.maximum(parts, 1e-6)))


def _derivatives(windows: Any, xp: ModuleType = jnp) -> tuple[Any, Any, Any]:
    """Differences of the target and their differences, (B, frames - 2, 1), and of the torques (B, frames - 2, SUB)."""
    change = xp.diff(windows[..., :1], axis=1)
    torque = windows[..., 1:].reshape(len(windows), -1)
    rate = xp.diff(torque, axis=1)[:, -(windows.shape[1] - 2) * SUB :].reshape(len(windows), -1, SUB)
    return change[:, 1:], xp.diff(change, axis=1), rate


def _compiled_chunk(optimisers: Mapping[str, Any], num_classes: int, period: float) -> Callable:
    # numbers of the runs are arguments: the compiled program can then be cached for all runs of a shape
    def made(weights: Weights, inputs: jnp.ndarray, which: jnp.ndarray, constants: Any) -> jnp.ndarray:
        """(B, frames, CHANNELS) bounded windows, scaled."""
        limits, scales, _ = constants
        bounds = Bounds(*limits[which].T)
        raw = learned_excitation.generator(weights, inputs, jnp) * scales[which][:, None]
        targets = jnp.swapaxes(raw[..., 0], 0, 1)

        rest, pairs = (targets[0], jnp.zeros_like(targets[0])), (targets[:-1], targets[1:])
        _, target = jax.lax.scan(lambda at, pair: bounded_stream.step(at, *pair, bounds, period, jnp), rest, pairs)
        torque = bounded_stream.soft_clip(raw[:, 1:, 1:], bounds.torque[:, None, None], jnp)
        whole = jnp.concatenate([jnp.swapaxes(target, 0, 1)[..., None], torque], axis=2)
        return (whole / scales[which][:, None])[:, BURN_IN:]

    def scores(weights: Weights, norms: Weights, windows: jnp.ndarray, which: Any, command: Any, changes: Any) -> Any:
        """(B,) of the critic: large for windows of runs."""
        # speeds, accelerations and torque rates are compressed: impacts would outweigh all else
        derivatives = [
            jnp.arcsinh(part / changes[which][:, index, None, None]) for index, part in enumerate(_derivatives(windows))
        ]
        given = jnp.concatenate([jax.nn.one_hot(which, num_classes), command[:, None]], axis=1)[:, None]
        given = jnp.broadcast_to(given, (*derivatives[0].shape[:2], given.shape[2]))
        hidden = jnp.concatenate([windows[:, 2:], *derivatives, given], axis=2)
        for layer in range(_LAYERS):
            found = convolved(hidden, weights[f"k{layer}"], stride=_STRIDE) / norms[f"k{layer}"] + weights[f"c{layer}"]
            hidden = jnp.where(found > 0.0, found, LEAK * found)
        pooled = jnp.concatenate(
            [hidden.mean(axis=1), jnp.sqrt(hidden.var(axis=1) + 1e-6), hidden.max(axis=1)], axis=1
        )
        return (pooled @ weights["out"])[:, 0] / norms["out"]

    def normed(weights: Weights, directions: Weights) -> tuple[Weights, Weights]:
        """One step of the power iteration: new directions, and the largest singular values."""
        moved, norms = {}, {}
        for name, before in directions.items():
            matrix = weights[name].reshape(-1, weights[name].shape[-1])
            left = jax.lax.stop_gradient(matrix @ before)
            left = left / (jnp.linalg.norm(left) + 1e-12)
            right = left @ matrix
            norms[name] = jnp.linalg.norm(right) + 1e-12
            moved[name] = jax.lax.stop_gradient(right / norms[name])
        return moved, norms

    def updated(state: dict[str, Any], name: str, gradient: Weights) -> dict[str, Any]:
        update, adam = optimisers[name].update(gradient, state[f"{name}_adam"], state[name])
        return state | {name: optax.apply_updates(state[name], update), f"{name}_adam": adam}

    def step(constants: Any, state: dict[str, Any], batch: Any) -> tuple[dict[str, Any], jnp.ndarray]:
        inputs, which, command, real = batch
        changes = constants[2]
        fake = jax.lax.stop_gradient(made(state["generator"], inputs[0], which[0], constants))

        def critic_loss(weights: Weights) -> Any:
            directions, norms = normed(weights, state["directions"])
            of_real = scores(weights, norms, real[0], which[0], command[0], changes)
            of_fake = scores(weights, norms, fake, which[0], command[0], changes)
            loss = jnp.mean(jax.nn.relu(1.0 - of_real)) + jnp.mean(jax.nn.relu(1.0 + of_fake))
            return loss, (directions, of_real.mean() - of_fake.mean())

        (_, (directions, gap)), gradient = jax.value_and_grad(critic_loss, has_aux=True)(state["critic"])
        state = updated(state, "critic", gradient) | {"directions": directions}
        _, norms = normed(state["critic"], directions)

        def generator_loss(weights: Weights) -> jnp.ndarray:
            windows = made(weights, inputs[1], which[1], constants)
            return -jnp.mean(scores(state["critic"], norms, windows, which[1], command[1], changes))

        state = updated(state, "generator", jax.grad(generator_loss)(state["generator"]))
        average = jax.tree.map(lambda a, b: DECAY * a + (1.0 - DECAY) * b, state["average"], state["generator"])
        return state | {"average": average}, gap

    @jax.jit
    def chunk(state: dict[str, Any], batches: Any, constants: Any) -> tuple[dict[str, Any], jnp.ndarray]:
        state, gaps = jax.lax.scan(partial(step, constants), state, batches)
        return state, jnp.mean(gaps)

    return chunk
