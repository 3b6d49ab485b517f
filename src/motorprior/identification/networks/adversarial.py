"""A generator of windows of joint motion, trained by reconstruction and against a critic.

Every recorded window x has a code and a gait phase, which are trained with the generator G (generative latent
optimisation, Bojanowski et al., ICML 2018). With z for code, phase and noise, the loss of the generator is

    L = Σ_i w_i·|r_i(x) - r_i(G(z))| + MATCHING·Σ_l |s(C_l(x)) - s(C_l(G(z)))| - ADVERSARIAL·C(G(z)).

r_i are the target, its differences, their differences and the mean torque of a frame. C_l are the inputs and hidden
layers of the critic C, s are mean, standard deviation, maximum and minimum over the window (feature matching, Salimans
et al., NeurIPS 2016). The critic has a hinge loss and spectral normalisation (Miyato et al., ICLR 2018).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
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
from motorprior.bench.learned_excitation import CHANNELS, CODE, LEAK, MIN_SCALE, RECEPTIVE, SUB, LearnedExcitation
from motorprior.exceptions import ArtifactError
from motorprior.progress import ReportProgress

CHUNK, BATCH, HIDDEN = 25, 32, 48  # steps per compiled call; windows per step; channels of the critic
RATES = {"critic": 1e-3, "generator": 3e-3, "codes": 2e-2}  # learning rates of Adam, which decay to 0 (cosine)
RECONSTRUCTION = (10.0, 5.0, 10.0, 3.0)  # w_i: target, its differences, their differences, mean torque
MATCHING, ADVERSARIAL = 5.0, 1.0  # weights of the other losses
CODE_NOISE = 0.05  # standard deviation of noise on codes in training: similar codes then give similar windows
ORDERS = 6  # harmonics in the initial codes
PHASE_UNIT = 0.2  # unit of the trained phases [rad]: they have the codes' learning rate
_LAYERS, _TAPS, _STRIDE, _POWER = 3, 5, 2, 16  # convolutions of the critic; steps of the power iteration
_TARGET = np.array([0, CHANNELS, CHANNELS + 1])  # columns of `seen`: the target, its differences, and theirs
_STREAM, _EDGE = 53, (RECEPTIVE - 1) // 2
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
    rates = {name: optax.cosine_decay_schedule(rate, steps) for name, rate in RATES.items()}
    optimisers = {name: optax.adam(rate, b1=0.5, b2=0.99) for name, rate in rates.items()}
    state, first = _initial(runs, seed, optimisers), 0
    leaves, structure = jax.tree.flatten(state)
    identity = {"settings": identity, "shapes": [list(leaf.shape) for leaf in leaves]}
    if checkpoint is not None:
        with suppress(ArtifactError):  # none, or a damaged one, which is written again
            tensors, header = read_tensors(checkpoint)
            if header.get("identity") == identity:
                kept = [jnp.asarray(tensors[str(index)], leaf.dtype) for index, leaf in enumerate(leaves)]
                state, first = jax.tree.unflatten(structure, kept), int(header["steps"])
                report(first, "continued")
    advance, constants = _compiled_chunk(optimisers), _constants(runs)
    for begin in range(first, steps, CHUNK):
        count = min(CHUNK, steps - begin)
        state, losses = advance(state, _batches(runs, np.random.default_rng([seed, _STREAM, begin]), count), constants)
        if checkpoint is not None:
            arrays = {str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))}
            write_tensors(checkpoint, arrays, {"identity": identity, "steps": begin + count})
        report(count, "reconstruction {:.2f}, critic's gap {:.2f}".format(*losses.tolist()))
    found = state["generator"] | {"codes": state["codes"][:, :CODE]}
    return {name: np.asarray(value, np.float64) for name, value in found.items()}


def _initial(runs: LearnedExcitation, seed: int, optimisers: Mapping[str, Any]) -> dict[str, Any]:
    rng = np.random.default_rng([seed, _STREAM])
    shapes: dict[str, tuple[int, ...]] = {"out": (4 * HIDDEN,)}
    for layer in range(_LAYERS):
        given = HIDDEN if layer else CHANNELS + 2 + SUB + len(runs.classes) + 1
        shapes |= {f"k{layer}": (_TAPS, given, HIDDEN), f"c{layer}": (HIDDEN,)}

    def weights(shapes: Mapping[str, tuple[int, ...]]) -> Weights:
        scale = {name: 1.0 / np.sqrt(max(1, np.prod(shape[:-1]))) for name, shape in shapes.items()}
        values = {n: scale[n] * rng.standard_normal(s) * (n == "out" or len(s) > 1) for n, s in shapes.items()}
        return {name: jnp.asarray(value, jnp.float32) for name, value in values.items()}

    made = weights(learned_excitation.weight_shapes(len(runs.classes), len(runs.windows)))
    del made["codes"]
    codes = jnp.asarray(np.column_stack([_initial_codes(runs), np.zeros(len(runs.windows))]), jnp.float32)
    networks = {"codes": codes, "generator": made, "critic": weights(shapes)}
    return networks | {f"{name}_adam": optimisers[name].init(own) for name, own in networks.items()}


def _phases(runs: LearnedExcitation) -> np.ndarray:
    """(W, frames + RECEPTIVE - 1) phase of the gait [rad], that of the target's fundamental, also around the window."""
    target = runs.windows[..., 0] - runs.windows[..., 0].mean(axis=1, keepdims=True)
    turned = 2 * np.pi * runs.frequency[:, None] * runs.period * np.arange(-_EDGE, target.shape[1] + _EDGE)
    first = np.angle((np.exp(-1j * turned[:, _EDGE:-_EDGE]) * target) @ np.hanning(target.shape[1]))
    return turned + first[:, None]


def _initial_codes(runs: LearnedExcitation) -> np.ndarray:
    """(W, CODE) principal components of windows: of harmonics of target and torque, and of sizes of `_derivatives`."""
    windows, phases = runs.windows / runs.scales[runs.window_class][:, None], _phases(runs)[:, _EDGE:-_EDGE]
    turns = np.arange(ORDERS + 1)[:, None, None] * phases
    waves = np.moveaxis(np.concatenate([np.cos(turns), np.sin(turns[1:])]), 0, 2)
    transposed, signals = np.swapaxes(waves, 1, 2), np.stack([windows[..., 0], windows[..., 1:].mean(axis=2)], axis=2)
    ridge = 0.01 * windows.shape[1] * np.eye(waves.shape[2])
    harmonics = np.linalg.solve(transposed @ waves + ridge, transposed @ signals).reshape(len(windows), -1)
    sizes = [np.log(part.std(axis=(1, 2)) + 1e-3) for part in _derivatives(windows, np)]
    found = np.column_stack([harmonics, *sizes])
    for kind in range(len(runs.classes)):
        found[runs.window_class == kind] -= found[runs.window_class == kind].mean(axis=0)
    codes = np.linalg.svd(found, full_matrices=False)[0][:, :CODE] * len(found) ** 0.5
    return np.pad(codes, ((0, 0), (0, CODE - codes.shape[1])))


def _batches(runs: LearnedExcitation, rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """For ``count`` steps: a BATCH of windows, with classes equally likely, and twice noise for generator and codes."""
    which = rng.integers(len(runs.classes), size=count * BATCH)
    chosen = np.stack([rng.choice(np.flatnonzero(runs.window_class == kind)) for kind in which])
    shape, frames = (count, 2, BATCH), runs.windows.shape[1] + RECEPTIVE - 1
    noise = rng.standard_normal((*shape, frames, learned_excitation.NOISE), np.float32)
    return chosen.reshape(count, BATCH), noise, rng.standard_normal((*shape, CODE), np.float32)


def _constants(runs: LearnedExcitation) -> Weights:
    """Of every window: itself, scaled; class, command, phases, sizes of `_derivatives`; and channels that move."""
    kind = runs.window_class
    windows = runs.windows / runs.scales[kind][:, None]
    sizes = [[np.std(part) for part in _derivatives(windows[kind == k], np)] for k in range(len(runs.classes))]
    found = {
        "windows": windows, "kinds": np.eye(len(runs.classes))[kind], "commands": runs.commands[:, None],
        "phases": _phases(runs), "sizes": np.maximum(sizes, 1e-6)[kind],
        "moving": (runs.scales > MIN_SCALE)[kind][:, None],
    }  # fmt: skip
    return {name: jnp.asarray(value, jnp.float32) for name, value in found.items()}


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


def _spectral_norm(kernel: Any) -> Any:
    """Largest singular value of a convolution's (taps · inputs, outputs) matrix, by power iteration."""
    matrix = kernel.reshape(-1, kernel.shape[-1])
    direction = jnp.ones(matrix.shape[1])
    for _ in range(_POWER):
        direction = matrix.T @ (matrix @ direction)
        direction = direction / jnp.linalg.norm(direction)
    return jnp.linalg.norm(matrix @ jax.lax.stop_gradient(direction))


def _compiled_chunk(optimisers: Mapping[str, Any]) -> Callable:
    # numbers of the runs are arguments: the compiled program can then be cached for all runs of a shape
    def seen(windows: Any, own: Weights) -> Any:
        """(B, frames - 2, CHANNELS + 2 + SUB) inputs of the critic: scaled windows and their `_derivatives`."""
        # compressed, since impacts would outweigh all else
        sizes = own["sizes"][:, :, None, None]
        parts = [jnp.arcsinh(part / sizes[:, index]) for index, part in enumerate(_derivatives(windows))]
        return jnp.concatenate([windows[:, 2:], *parts], axis=2)

    def scores(weights: Weights, signals: Any, own: Weights) -> tuple[Any, list[Any]]:
        """(B,) of the critic, large for windows of runs; and its inputs and hidden layers, pooled."""
        given = jnp.concatenate([own["kinds"], own["commands"]], axis=1)[:, None]
        given = jnp.broadcast_to(given, (*signals.shape[:2], given.shape[2]))
        hidden, layers = jnp.concatenate([signals, given], axis=2), [_pooled(signals)]
        for layer in range(_LAYERS):
            kernel = weights[f"k{layer}"]
            found = learned_excitation.convolved(hidden, kernel / _spectral_norm(kernel), stride=_STRIDE)
            found = found + weights[f"c{layer}"]
            hidden = jnp.where(found > 0.0, found, LEAK * found)
            layers.append(_pooled(hidden))
        return layers[-1] @ weights["out"] / jnp.linalg.norm(weights["out"]), layers

    def updated(state: dict[str, Any], name: str, gradient: Weights) -> dict[str, Any]:
        update, adam = optimisers[name].update(gradient, state[f"{name}_adam"], state[name])
        return state | {name: optax.apply_updates(state[name], update), f"{name}_adam": adam}

    def step(constants: Weights, state: dict[str, Any], batch: Any) -> tuple[dict[str, Any], Any]:
        chosen, noise, code_noise = batch
        own = {name: value[chosen] for name, value in constants.items()}
        trained = state["generator"], state["codes"]
        real = seen(own["windows"], own)

        def fake(weights: Weights, codes: Any, which: int) -> Any:
            """`seen` of the generator's windows."""
            phases = own["phases"] + PHASE_UNIT * codes[chosen, CODE:]
            moved = codes[chosen, :CODE] + CODE_NOISE * code_noise[which]
            conditions = jnp.concatenate([moved, own["commands"], own["kinds"]], axis=1)[:, None]
            conditions = jnp.broadcast_to(conditions, (*phases.shape, conditions.shape[-1]))
            found = learned_excitation.generator(weights, phases, conditions, noise[which], jnp)
            return seen(found * own["moving"], own)

        first = jax.lax.stop_gradient(fake(*trained, 0))

        def critic_loss(weights: Weights) -> Any:
            of_real, of_fake = (scores(weights, signals, own)[0] for signals in (real, first))
            loss = jnp.mean(jax.nn.relu(1.0 - of_real)) + jnp.mean(jax.nn.relu(1.0 + of_fake))
            return loss, of_real.mean() - of_fake.mean()

        (_, gap), gradient = jax.value_and_grad(critic_loss, has_aux=True)(state["critic"])
        state = updated(state, "critic", gradient)
        _, wanted = scores(state["critic"], real, own)

        def generator_loss(weights: Weights, codes: Any) -> Any:
            signals = fake(weights, codes, 1)
            score, layers = scores(state["critic"], signals, own)
            apart = jnp.mean(jnp.abs(signals[..., _TARGET] - real[..., _TARGET]), axis=(0, 1))
            torque = jnp.mean(signals[..., 1:CHANNELS] - real[..., 1:CHANNELS], axis=2)
            rebuilt = jnp.append(apart, jnp.mean(jnp.abs(torque))) @ jnp.array(RECONSTRUCTION)
            matched = sum(jnp.mean(jnp.abs(a - b)) for a, b in zip(layers, wanted, strict=True))
            return rebuilt + MATCHING * matched - ADVERSARIAL * jnp.mean(score), rebuilt

        (_, rebuilt), gradients = jax.value_and_grad(generator_loss, argnums=(0, 1), has_aux=True)(*trained)
        for name, gradient in zip(("generator", "codes"), gradients, strict=True):
            state = updated(state, name, gradient)
        return state, jnp.stack([rebuilt, gap])

    @jax.jit
    def chunk(state: dict[str, Any], batches: Any, constants: Weights) -> tuple[dict[str, Any], Any]:
        state, losses = jax.lax.scan(partial(step, constants), state, batches)
        return state, losses.mean(axis=0)

    return chunk
