"""A generator of windows of joint motion, trained by reconstruction and against a critic.

Every recorded window has a code, a phase and a frequency, which are learned together with the generator (generative
latent optimisation, Bojanowski et al., ICML 2018). The loss of the generator is

    L = REC·|x - G(z)| + FM·Σ_l |s(C_l(x)) - s(C_l(G(z)))| - C(G(z))

for a window x, of the target and its differences and the mean torques of frames; C_l are the inputs and hidden layers
of the critic C, and s are mean, standard deviation and maximum over the window (feature matching: Salimans et al.,
NeurIPS 2016; Larsen et al., ICML 2016). The critic has a hinge loss (Lim & Ye, Geometric GAN, 2017) and spectral
normalisation (Miyato et al., ICLR 2018). An exponential moving average of the generator's weights plays.
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
from motorprior.bench import learned_excitation
from motorprior.bench.learned_excitation import (
    CHANNELS,
    CODE,
    LEAK,
    NOISE,
    RECEPTIVE,
    SUB,
    LearnedExcitation,
    convolved,
    weight_shapes,
)
from motorprior.progress import ReportProgress

CHUNK, BATCH, HIDDEN = 25, 32, 48  # steps per compiled call; windows per step; channels of the critic
RATES = {"critic": 1e-3, "generator": 2e-3, "latent": 2e-2}  # learning rates of Adam, b1 = 0.5
DECAY = 0.995  # decay of the moving average of weights
RECONSTRUCTION, MATCHING, ADVERSARIAL = 10.0, 5.0, 0.5  # weights of the losses
CODE_NOISE = 0.1  # standard deviation of the noise on codes in training, so that near codes have similar windows
PHASE_RATE = 0.2
ACC = 0.5
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
    optimisers = {name: optax.adam(optax.cosine_decay_schedule(rate, steps), b1=0.5, b2=0.99) for name, rate in RATES.items()}
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
        state, losses = advance(state, _batches(runs, np.random.default_rng([seed, _STREAM, begin]), count), constants)
        if checkpoint is not None:
            arrays = {str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))}
            write_tensors(checkpoint, arrays, {"identity": identity, "steps": begin + count})
        report(count, ", ".join(f"{name} {float(value):.2f}" for name, value in losses.items()))
    average = state["average"]
    found = average["generator"] | {"codes": average["latent"]["codes"]}
    return {name: np.asarray(value, np.float64) for name, value in found.items()}


def _initial(runs: LearnedExcitation, seed: int, optimisers: Mapping[str, Any]) -> dict[str, Any]:
    rng = np.random.default_rng([seed, _STREAM])

    def weights(shapes: Mapping[str, tuple[int, ...]]) -> Weights:
        scale = {name: 1.0 / np.sqrt(max(1, np.prod(shape[:-1]))) for name, shape in shapes.items()}
        values = {n: scale[n] * rng.standard_normal(s) * (len(s) > 1) for n, s in shapes.items()}
        return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}

    given = CHANNELS + 2 + SUB + len(runs.classes) + 1
    sizes = (given, *(HIDDEN for _ in range(_LAYERS)))
    shapes: dict[str, tuple[int, ...]] = {"out": (4 * HIDDEN, 1)}
    for layer, size in enumerate(sizes[:-1]):
        shapes |= {f"k{layer}": (_TAPS, size, HIDDEN), f"c{layer}": (HIDDEN,)}
    making, critic = weights(weight_shapes(len(runs.classes), len(runs.windows))), weights(shapes)
    codes, phases = _latents(runs)
    del making["codes"]
    latent = {"codes": jnp.asarray(codes, jnp.float32), "phases": jnp.asarray(phases / PHASE_RATE, jnp.float32)}
    directions = {n: jnp.asarray(rng.standard_normal(s[-1]), jnp.float32) for n, s in shapes.items() if len(s) > 1}
    return {
        "generator": making, "critic": critic, "latent": latent, "directions": directions,
        "average": {"generator": making, "latent": latent},
        **{f"{n}_adam": optimisers[n].init(o) for n, o in (("generator", making), ("critic", critic), ("latent", latent))},
    }  # fmt: skip


def _latents(runs: LearnedExcitation) -> tuple[np.ndarray, np.ndarray]:
    """(W, CODE) initial codes, principal components of the harmonics; (W,) phases [rad] of the gait at the first frame."""
    time, windows = runs.period * np.arange(runs.windows.shape[1]), runs.windows / runs.scales[runs.window_class][:, None]
    angle = 2 * np.pi * runs.frequency[:, None] * time
    target = windows[..., 0] - windows[..., 0].mean(axis=1, keepdims=True)
    phases = np.angle(np.sum(np.hanning(len(time)) * np.exp(-1j * angle) * target, axis=1))
    signals = np.stack([windows[..., 0], windows[..., 1:].mean(axis=2)], axis=2)
    orders = np.arange(7)[:, None, None] * (angle + phases[:, None])
    waves = np.moveaxis(np.concatenate([np.cos(orders), np.sin(orders[1:])]), 0, 2)
    square = np.swapaxes(waves, 1, 2) @ waves + 0.01 * len(time) * np.eye(waves.shape[2])
    found = np.linalg.solve(square, np.swapaxes(waves, 1, 2) @ signals).reshape(len(windows), -1)
    rates = [np.log(part.std(axis=(1, 2)) + 1e-3) for part in _derivatives(windows, np)]
    found = np.column_stack([found, *rates])
    for kind in range(len(runs.classes)):
        found[runs.window_class == kind] -= found[runs.window_class == kind].mean(axis=0)
    codes = np.linalg.svd(found, full_matrices=False)[0][:, :CODE]
    return codes * len(codes) ** 0.5, phases


def _batches(runs: LearnedExcitation, rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """For ``count`` steps and a BATCH: windows, and twice noise of the generator and noise of the codes."""
    which = rng.integers(len(runs.classes), size=count * BATCH)
    chosen = np.stack([rng.choice(np.flatnonzero(runs.window_class == kind)) for kind in which])
    frames = runs.windows.shape[1] + RECEPTIVE - 1
    noise = rng.standard_normal((count, 2, BATCH, frames, NOISE), np.float32)
    return chosen.reshape(count, BATCH), noise, rng.standard_normal((count, 2, BATCH, CODE), np.float32)


def _constants(runs: LearnedExcitation) -> tuple[jnp.ndarray, ...]:
    """Scaled windows, classes (one-hot), commands, and of each class standard deviations of `_derivatives`."""
    windows = runs.windows / runs.scales[runs.window_class][:, None]
    own = [windows[runs.window_class == kind] for kind in range(len(runs.classes))]
    parts = [[np.std(part) for part in _derivatives(each, np)] for each in own]
    kinds = np.eye(len(runs.classes))[runs.window_class]
    return tuple(
        jnp.asarray(value, jnp.float32)
        for value in (windows, kinds, runs.commands, np.maximum(parts, 1e-6)[runs.window_class], runs.frequency)
    )


def _derivatives(windows: Any, xp: ModuleType = jnp) -> tuple[Any, Any, Any]:
    """Differences of the target and their differences, (B, frames - 2, 1), and of the torques (B, frames - 2, SUB)."""
    change = xp.diff(windows[..., :1], axis=1)
    torque = windows[..., 1:].reshape(len(windows), -1)
    rate = xp.diff(torque, axis=1)[:, -(windows.shape[1] - 2) * SUB :].reshape(len(windows), -1, SUB)
    return change[:, 1:], xp.diff(change, axis=1), rate


def _pooled(signal: Any) -> Any:
    """(B, 4·C) mean, standard deviation, maximum and minimum over the frames of (B, frames, C)."""
    parts = [signal.mean(axis=1), jnp.sqrt(signal.var(axis=1) + 1e-6), signal.max(axis=1), signal.min(axis=1)]
    return jnp.concatenate(parts, axis=1)


def _compiled_chunk(optimisers: Mapping[str, Any], num_classes: int, period: float) -> Callable:
    # numbers of the runs are arguments: the compiled program can then be cached for all runs of a shape
    def made(weights: Weights, latent: Weights, chosen: Any, noise: Any, code_noise: Any, constants: Any) -> jnp.ndarray:
        """(B, frames, CHANNELS) windows, scaled."""
        _, kinds, commands, _, frequency = constants
        at = jnp.arange(noise.shape[1]) - (RECEPTIVE - 1) // 2
        phase = PHASE_RATE * latent["phases"][chosen][:, None] + 2 * jnp.pi * period * frequency[chosen][:, None] * at
        conditions = [latent["codes"][chosen] + CODE_NOISE * code_noise, commands[chosen][:, None], kinds[chosen]]
        conditions = jnp.concatenate(conditions, axis=1)[:, None]
        conditions = jnp.broadcast_to(conditions, (*phase.shape, conditions.shape[-1]))
        return learned_excitation.generator(weights, phase, conditions, noise, jnp)

    def seen(windows: jnp.ndarray, chosen: Any, constants: Any) -> Any:
        """Inputs of the critic: windows, and their derivatives."""
        # compressed, since impacts would outweigh all else
        changes = constants[3][chosen]
        derivatives = [
            jnp.arcsinh(part / changes[:, index, None, None]) for index, part in enumerate(_derivatives(windows))
        ]
        return jnp.concatenate([windows[:, 2:], *derivatives], axis=2)

    def scores(weights: Weights, norms: Weights, signals: jnp.ndarray, chosen: Any, constants: Any) -> Any:
        """(B,) of the critic, large for windows of runs; and what it sees, pooled."""
        given = jnp.concatenate([constants[1][chosen], constants[2][chosen][:, None]], axis=1)[:, None]
        given = jnp.broadcast_to(given, (*signals.shape[:2], given.shape[2]))
        hidden, layers = jnp.concatenate([signals, given], axis=2), [_pooled(signals)]
        for layer in range(_LAYERS):
            found = convolved(hidden, weights[f"k{layer}"], stride=_STRIDE) / norms[f"k{layer}"] + weights[f"c{layer}"]
            hidden = jnp.where(found > 0.0, found, LEAK * found)
            layers.append(_pooled(hidden))
        return (layers[-1] @ weights["out"])[:, 0] / norms["out"], layers

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

    def step(constants: Any, state: dict[str, Any], batch: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        chosen, noise, code_noise = batch
        real = seen(constants[0][chosen], chosen, constants)
        fake = made(state["generator"], state["latent"], chosen, noise[0], code_noise[0], constants)
        fake = jax.lax.stop_gradient(seen(fake, chosen, constants))

        def critic_loss(weights: Weights) -> Any:
            directions, norms = normed(weights, state["directions"])
            of_real, _ = scores(weights, norms, real, chosen, constants)
            of_fake, _ = scores(weights, norms, fake, chosen, constants)
            loss = jnp.mean(jax.nn.relu(1.0 - of_real)) + jnp.mean(jax.nn.relu(1.0 + of_fake))
            return loss, (directions, of_real.mean() - of_fake.mean())

        (_, (directions, gap)), gradient = jax.value_and_grad(critic_loss, has_aux=True)(state["critic"])
        state = updated(state, "critic", gradient) | {"directions": directions}
        _, norms = normed(state["critic"], directions)
        _, wanted = scores(state["critic"], norms, real, chosen, constants)

        def generator_loss(weights: Weights, latent: Weights) -> Any:
            windows = made(weights, latent, chosen, noise[1], code_noise[1], constants)
            signals = seen(windows, chosen, constants)
            score, layers = scores(state["critic"], norms, signals, chosen, constants)
            smooth = jnp.concatenate([signals[..., :1], signals[..., CHANNELS : CHANNELS + 2]], axis=2)
            smooth_real = jnp.concatenate([real[..., :1], real[..., CHANNELS : CHANNELS + 2]], axis=2)
            apart = jnp.mean(jnp.abs(smooth - smooth_real), axis=(0, 1))
            torque = jnp.mean(jnp.abs(signals[..., 1:CHANNELS].mean(axis=2) - real[..., 1:CHANNELS].mean(axis=2)))
            rebuilt = apart @ jnp.array([1.0, 0.5, ACC]) + 0.3 * torque
            matched = sum(jnp.mean(jnp.abs(a - b)) for a, b in zip(layers, wanted, strict=True))
            regular = 1e-2 * jnp.mean(latent["codes"] ** 2)
            loss = RECONSTRUCTION * rebuilt + MATCHING * matched - ADVERSARIAL * jnp.mean(score) + regular
            return loss, {"t": apart[0], "d": apart[1], "a": apart[2], "tau": torque, "fm": matched}

        own = {name: state[name] for name in ("generator", "latent")}
        slopes = jax.value_and_grad(generator_loss, argnums=(0, 1), has_aux=True)
        (_, losses), gradients = slopes(*own.values())
        for name, gradient in zip(own, gradients, strict=True):
            state = updated(state, name, gradient)
            own[name] = state[name]
        average = jax.tree.map(lambda a, b: DECAY * a + (1.0 - DECAY) * b, state["average"], own)
        return state | {"average": average}, losses | {"gap": gap}

    @jax.jit
    def chunk(state: dict[str, Any], batches: Any, constants: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        state, losses = jax.lax.scan(partial(step, constants), state, batches)
        return state, jax.tree.map(jnp.mean, losses)

    return chunk
