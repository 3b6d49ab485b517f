"""A generator of windows of joint motion, trained by reconstruction and against a critic.

Every recorded window x has a code and a gait phase, which are trained with the generator G
(generative latent optimisation, Bojanowski et al., ICML 2018). With z for code, phase and noise,
the losses are

    Σ_i w_i·|r_i(x) - r_i(G(z))| + MATCHING·Σ_l |s(C_l(x)) - s(C_l(G(z)))| - C(G(z))

for codes and generator, and for the critic C

    max(0, 1 - C(x)) + max(0, 1 + C(G(z))).

r_i are the target, its differences, their differences and the mean torque of a frame. C_l are the
inputs and hidden layers of the critic, s are mean, standard deviation, maximum and minimum over the
window (feature matching, Salimans et al., NeurIPS 2016). The critic's weights have spectral norm 1
(Miyato et al., ICLR 2018).
"""

from collections.abc import Hashable, Mapping
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import optax

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError
from motorprior.excitation.frames import CHANNELS, TORQUES_PER_FRAME
from motorprior.excitation.generator import (
    CODE_SIZE,
    EDGE,
    NOISE,
    convolved,
    generator,
    leaky,
    weight_shapes,
)
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.jax_device import use_cpu_by_default
from motorprior.progress import ReportProgress

CHUNK = 25  # steps per compiled call
BATCH = 32  # windows per step
# learning rates of Adam, which decay to 0 (cosine)
RATES = {"codes": 2e-2, "generator": 3e-3, "critic": 1e-3}
RECONSTRUCTION = [10.0, 5.0, 10.0, 3.0]  # w_i
MATCHING = 5.0
# standard deviation of noise on codes in training: similar codes then give similar windows
CODE_NOISE = 0.05
PHASE_UNIT = 0.2  # unit of the trained phases [rad]: they have the codes' learning rate
# convolutions of the critic
CRITIC_LAYERS = 3
CRITIC_WIDTH = 48
CRITIC_TAPS = 5
CRITIC_DILATION = 2
ORDERS = 6  # harmonics in the initial codes
_TINY = 1e-6
Weights: TypeAlias = dict[str, Any]


def train_generator(
    runs: LearnedExcitation,
    steps: int,
    seed: int,
    checkpoint: Path | None = None,
    identity: Mapping[str, Any] | None = None,
    report: ReportProgress = lambda count, text: None,
) -> dict[str, np.ndarray]:
    """Weights of a generator of windows like the windows of ``runs``; deterministic.

    The state after every CHUNK steps is in the file ``checkpoint``; a call with the same
    ``identity`` continues there.
    """
    use_cpu_by_default()
    optimiser = _optimiser(steps)
    data = _training_data(runs)

    # numbers of the runs are arguments: the compiled program can then be cached for all runs of a
    # shape
    @jax.jit
    def advance(state: Any, keys: Any, data: Weights) -> tuple[Any, Any]:
        def step(state: Any, key: Any) -> tuple[Any, Any]:
            gradient, losses = jax.grad(_loss, has_aux=True)(state[0], data, key)
            update, adam = optimiser.update(gradient, state[1], state[0])
            return (optax.apply_updates(state[0], update), adam), losses

        state, losses = jax.lax.scan(step, state, keys)
        return state, losses.mean(axis=0)

    networks = _initial_weights(len(runs.classes), seed) | {"codes": data["codes"]}
    state = (networks, optimiser.init(networks))
    shapes = [list(leaf.shape) for leaf in jax.tree.leaves(state)]
    settings = {"settings": identity, "shapes": shapes}
    first = 0
    if checkpoint is not None:
        with suppress(ArtifactError):  # none, or a damaged one, which is written again
            state, first = _saved_state(checkpoint, settings, state)
    if first:
        report(first, "continued")

    keys = jax.random.split(jax.random.key(seed), steps)
    for begin in range(first, steps, CHUNK):
        state, losses = advance(state, keys[begin : begin + CHUNK], data)
        count = min(CHUNK, steps - begin)
        if checkpoint is not None:
            _save_state(checkpoint, settings, state, begin + count)
        reconstruction, gap = losses.tolist()
        report(count, f"reconstruction {reconstruction:.2f}, critic's gap {gap:.2f}")

    weights = state[0]["generator"] | {"codes": state[0]["codes"][:, :CODE_SIZE]}
    return {name: np.asarray(value, np.float64) for name, value in weights.items()}


def _optimiser(steps: int) -> Any:
    """Adam with the RATES of the networks."""
    adams: dict[Hashable, Any] = {}
    for name, rate in RATES.items():
        schedule = optax.cosine_decay_schedule(rate, steps)
        adams[name] = optax.adam(schedule, b1=0.5, b2=0.99)
    return optax.multi_transform(adams, {name: name for name in RATES})


def _saved_state(checkpoint: Path, settings: dict[str, Any], initial: Any) -> tuple[Any, int]:
    """State in a checkpoint, and the number of its steps; the initial one for other settings.

    Raises ArtifactError if there is no checkpoint or it is damaged.
    """
    tensors, header = read_tensors(checkpoint)
    if header.get("identity") != settings:
        return initial, 0
    leaves, structure = jax.tree.flatten(initial)
    saved_leaves = [
        jnp.asarray(tensors[str(index)], leaf.dtype) for index, leaf in enumerate(leaves)
    ]
    return jax.tree.unflatten(structure, saved_leaves), int(header["steps"])


def _save_state(checkpoint: Path, settings: dict[str, Any], state: Any, steps: int) -> None:
    arrays = {str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))}
    write_tensors(checkpoint, arrays, {"identity": settings, "steps": steps})


def _training_data(runs: LearnedExcitation) -> Weights:
    """Arrays with a row for each of the W windows.

    windows (W, frames, CHANNELS) scaled; conditioning (W, 1 + classes) commanded speed and class;
    phases (W, frames + 2 EDGE) of the gait [rad]; codes (W, CODE_SIZE + 1) initial values, the last
    one is the trained phase; sizes (W, 3) of the `_derivatives` of the window's class.
    """
    classes = np.eye(len(runs.classes))[runs.window_class]
    class_means = classes @ np.linalg.pinv(classes)  # (W, W) gives means over a window's class
    windows = runs.windows / runs.scales[runs.window_class][:, None]
    squares = np.stack(
        [np.mean(derivative**2, axis=(1, 2)) for derivative in _derivatives(windows, np)], axis=1
    )

    phases = _gait_phases(runs, windows)
    features = _features(windows, phases, squares)
    components = np.linalg.svd(features - class_means @ features, full_matrices=False)[0]
    codes = components[:, :CODE_SIZE] * len(features) ** 0.5
    codes = np.pad(codes, ((0, 0), (0, CODE_SIZE + 1 - codes.shape[1])))

    data = {
        "windows": windows,
        "conditioning": np.column_stack([runs.commands, classes]),
        "phases": phases,
        "codes": codes,
        "sizes": np.sqrt(class_means @ squares) + _TINY,
    }
    return {name: jnp.asarray(value, jnp.float32) for name, value in data.items()}


def _gait_phases(runs: LearnedExcitation, windows: np.ndarray) -> np.ndarray:
    """(W, frames + 2 EDGE) phase of the target's fundamental [rad], also around the window."""
    num_frames = windows.shape[1]
    frame = np.arange(-EDGE, num_frames + EDGE)
    turned = 2 * np.pi * runs.frequency[:, None] * runs.period * frame
    target = windows[..., 0] - windows[..., 0].mean(axis=1, keepdims=True)
    fundamental = (np.exp(-1j * turned[:, EDGE:-EDGE]) * target) @ _taper(num_frames)
    return turned + np.angle(fundamental)[:, None]


def _features(windows: np.ndarray, phases: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """(W, K) harmonics of target and mean torque, and logarithms of the sizes of derivatives."""
    orders = np.arange(ORDERS + 1)[:, None, None]
    waves = 2.0 * _taper(windows.shape[1]) * np.exp(-1j * orders * phases[:, EDGE:-EDGE])
    signals = np.stack([windows[..., 0], windows[..., 1:].mean(axis=2)])
    harmonics = np.einsum("kwf,swf->wks", waves, signals).reshape(len(windows), -1)
    return np.column_stack([harmonics.real, harmonics.imag, 0.5 * np.log(squares + _TINY)])


def _taper(num_frames: int) -> np.ndarray:
    return np.hanning(num_frames) / np.hanning(num_frames).sum()


def _initial_weights(num_classes: int, seed: int) -> dict[str, Any]:
    """Random weights of generator and critic; zeros for biases.

    Their variance is 1 / inputs of a layer.
    """
    rng = np.random.default_rng([seed, 53])
    networks: dict[str, Any] = {}
    for network, shapes in {
        "generator": weight_shapes(num_classes),
        "critic": _critic_shapes(num_classes),
    }.items():
        weights = {}
        for name, shape in shapes.items():
            is_bias = name[0] in "bc"
            scale = (not is_bias) / np.sqrt(max(1, np.prod(shape[:-1])))
            weights[name] = jnp.asarray(scale * rng.standard_normal(shape), jnp.float32)
        networks[network] = weights
    return networks


def _critic_shapes(num_classes: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the critic's weights by name."""
    shapes: dict[str, tuple[int, ...]] = {"w_out": (4 * CRITIC_WIDTH,)}
    for layer in range(CRITIC_LAYERS):
        num_inputs = CRITIC_WIDTH if layer else CHANNELS + 2 + TORQUES_PER_FRAME + num_classes + 1
        shapes[f"w{layer}"] = (CRITIC_TAPS, num_inputs, CRITIC_WIDTH)
        shapes[f"b{layer}"] = (CRITIC_WIDTH,)
    return shapes


def _derivatives(windows: Any, xp: ModuleType = jnp) -> tuple[Any, Any, Any]:
    """First and second differences of the target, and differences of the torques.

    Shapes (B, frames - 2, 1), (B, frames - 2, 1) and (B, frames - 2, TORQUES_PER_FRAME).
    """
    change = xp.diff(windows[..., :1], axis=1)
    num_rows = windows.shape[1] - 2
    torque = windows[..., 1:].reshape(len(windows), -1)
    last_changes = xp.diff(torque, axis=1)[:, -num_rows * TORQUES_PER_FRAME :]
    rate = last_changes.reshape(len(windows), -1, TORQUES_PER_FRAME)
    return change[:, 1:], xp.diff(change, axis=1), rate


def _critic_inputs(windows: Any, batch: Weights) -> Any:
    """(B, frames - 2, num_inputs) windows, `_derivatives`, conditioning.

    num_inputs is CHANNELS + 2 + TORQUES_PER_FRAME + 1 + classes.

    Derivatives are scaled and compressed, since impacts would outweigh all else.
    """
    sizes = batch["sizes"][:, :, None, None]
    derivatives = [
        jnp.arcsinh(derivative / sizes[:, index])
        for index, derivative in enumerate(_derivatives(windows))
    ]
    conditioning = jnp.repeat(batch["conditioning"][:, None], windows.shape[1] - 2, axis=1)
    return jnp.concatenate([windows[:, 2:], *derivatives, conditioning], axis=2)


def _scores(critic: Weights, inputs: Any) -> tuple[Any, list[Any]]:
    """(B,) scores, large for windows of runs; inputs and hidden layers, pooled over the frames."""
    layers = [inputs]
    for layer in range(CRITIC_LAYERS):
        kernel = critic[f"w{layer}"]
        matrix = kernel.reshape(-1, CRITIC_WIDTH)
        norm = jnp.sqrt(jnp.linalg.eigvalsh(matrix.T @ matrix)[-1])
        output = convolved(layers[-1], kernel / norm, CRITIC_DILATION) + critic[f"b{layer}"]
        layers.append(leaky(output, jnp))

    pooled = [_pooled(values) for values in layers]
    scores = pooled[-1] @ critic["w_out"] / jnp.linalg.norm(critic["w_out"])
    return scores, pooled


def _pooled(values: Any) -> Any:
    """(B, 4 C) mean, standard deviation, maximum and minimum of ``values`` (B, frames, C)."""
    statistics = [
        values.mean(axis=1),
        jnp.sqrt(values.var(axis=1) + _TINY),
        values.max(axis=1),
        values.min(axis=1),
    ]
    return jnp.concatenate(statistics, axis=1)


def _loss(networks: dict[str, Any], data: Weights, key: Any) -> tuple[Any, Any]:
    """Sum of the losses of all networks for a random batch.

    Also returns the loss of the reconstruction and the critic's gap, to report.
    """
    batch_key, code_key, noise_key = jax.random.split(key, 3)
    rows = jax.random.randint(batch_key, (BATCH,), 0, len(data["windows"]))
    batch = {name: value[rows] for name, value in data.items()}
    generated = _generated(networks, batch, rows, code_key, noise_key)
    real = _critic_inputs(batch["windows"], batch)
    fake = _critic_inputs(generated, batch)

    # the critic learns from fixed windows
    score_of_real, layers = _scores(networks["critic"], real)
    score_of_fake, _ = _scores(networks["critic"], jax.lax.stop_gradient(fake))
    hinge = jnp.mean(jax.nn.relu(1.0 - score_of_real)) + jnp.mean(jax.nn.relu(1.0 + score_of_fake))

    # codes and generator learn from a fixed critic
    score, layers_of_fake = _scores(jax.lax.stop_gradient(networks["critic"]), fake)
    pairs = zip(layers_of_fake, jax.lax.stop_gradient(layers), strict=True)
    matching = sum(jnp.mean(jnp.abs(of_fake - of_real)) for of_fake, of_real in pairs)
    reconstruction = _reconstruction(fake - real)

    total = hinge + reconstruction + MATCHING * matching - jnp.mean(score)
    gap = score_of_real.mean() - score_of_fake.mean()
    return total, jnp.stack([reconstruction, gap])


def _generated(
    networks: dict[str, Any], batch: Weights, rows: Any, code_key: Any, noise_key: Any
) -> Any:
    """(B, frames, CHANNELS) scaled windows of the generator for the codes of these rows."""
    codes = networks["codes"][rows, :CODE_SIZE]
    phases = batch["phases"] + PHASE_UNIT * networks["codes"][rows, CODE_SIZE:]
    codes = codes + CODE_NOISE * jax.random.normal(code_key, codes.shape)
    conditioning = jnp.concatenate([codes, batch["conditioning"]], axis=1)
    conditioning = jnp.repeat(conditioning[:, None], phases.shape[1], axis=1)
    noise = jax.random.normal(noise_key, (*phases.shape, NOISE))
    return generator(networks["generator"], phases, conditioning, noise, jnp)


def _reconstruction(difference: Any) -> Any:
    """Weighted absolute differences of target, its derivatives and mean torque.

    ``difference`` is of `_critic_inputs`.
    """
    mean_torque = difference[..., 1:CHANNELS].mean(axis=2, keepdims=True)
    target = difference[..., :1]
    derivatives = difference[..., CHANNELS : CHANNELS + 2]
    compared = jnp.concatenate([target, derivatives, mean_torque], axis=2)
    return jnp.mean(jnp.abs(compared), axis=(0, 1)) @ jnp.array(RECONSTRUCTION)
