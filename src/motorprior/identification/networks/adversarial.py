"""A generator of windows of joint motion, trained by reconstruction and against a critic.

Every recorded window x has a code and a gait phase, which are trained with the generator G
(generative latent optimisation, Bojanowski et al., ICML 2018). With z for code, phase and noise,
the losses are

    Σ_i w_i·|r_i(x) - r_i(G(z))| + MATCHING·Σ_l |s(C_l(x)) - s(C_l(G(z)))| - C(G(z))    of codes and generator,
    max(0, 1 - C(x)) + max(0, 1 + C(G(z)))                                              of the critic C.

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
from motorprior.bench import learned_excitation
from motorprior.bench.learned_excitation import CHANNELS, CODE, EDGE, NOISE, SUB, LearnedExcitation
from motorprior.exceptions import ArtifactError
from motorprior.identification.networks.device import use_cpu_by_default
from motorprior.progress import ReportProgress

# steps per compiled call; windows per step
CHUNK = 25
BATCH = 32
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
STRIDE = 2
ORDERS = 6  # harmonics in the initial codes
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

    The state after every CHUNK steps is in the file ``checkpoint``; a call with the same
    ``identity`` continues there.
    """
    use_cpu_by_default()
    schedules = {name: optax.cosine_decay_schedule(rate, steps) for name, rate in RATES.items()}
    adams: dict[Hashable, Any] = {
        name: optax.adam(each, b1=0.5, b2=0.99) for name, each in schedules.items()
    }
    optimiser = optax.multi_transform(adams, {name: name for name in RATES})
    data = _data(runs)

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

    networks = _initial(len(runs.classes), seed) | {"codes": data["codes"]}
    state = (networks, optimiser.init(networks))
    first = 0
    leaves, structure = jax.tree.flatten(state)
    identity = {"settings": identity, "shapes": [list(leaf.shape) for leaf in leaves]}
    if checkpoint is not None:
        with suppress(ArtifactError):  # none, or a damaged one, which is written again
            tensors, header = read_tensors(checkpoint)
            if header.get("identity") == identity:
                kept = [
                    jnp.asarray(tensors[str(index)], leaf.dtype)
                    for index, leaf in enumerate(leaves)
                ]
                state = jax.tree.unflatten(structure, kept)
                first = int(header["steps"])
                report(first, "continued")
    keys = jax.random.split(jax.random.key(seed), steps)
    for begin in range(first, steps, CHUNK):
        state, losses = advance(state, keys[begin : begin + CHUNK], data)
        count = min(CHUNK, steps - begin)
        if checkpoint is not None:
            arrays = {
                str(index): np.asarray(leaf) for index, leaf in enumerate(jax.tree.leaves(state))
            }
            write_tensors(checkpoint, arrays, {"identity": identity, "steps": begin + count})
        report(count, "reconstruction {:.2f}, critic's gap {:.2f}".format(*losses.tolist()))
    found = state[0]["generator"] | {"codes": state[0]["codes"][:, :CODE]}
    return {name: np.asarray(value, np.float64) for name, value in found.items()}


def _data(runs: LearnedExcitation) -> Weights:
    """Of every window: scaled signals; command and class; phases; initial code; sizes of its class's `_derivatives`."""
    kinds = np.eye(len(runs.classes))[runs.window_class]
    class_means = kinds @ np.linalg.pinv(kinds)
    windows = runs.windows / runs.scales[runs.window_class][:, None]
    squares = np.stack(
        [np.mean(part**2, axis=(1, 2)) for part in _derivatives(windows, np)], axis=1
    )
    # phase of the gait, that of the target's fundamental, also EDGE frames around the window
    taper = np.hanning(windows.shape[1]) / np.hanning(windows.shape[1]).sum()
    turned = (
        2
        * np.pi
        * runs.frequency[:, None]
        * runs.period
        * np.arange(-EDGE, windows.shape[1] + EDGE)
    )
    target = windows[..., 0] - windows[..., 0].mean(axis=1, keepdims=True)
    phases = turned + np.angle((np.exp(-1j * turned[:, EDGE:-EDGE]) * target) @ taper)[:, None]
    # codes begin as principal components of harmonics of target and torque, and of sizes of
    # `_derivatives`
    waves = 2.0 * taper * np.exp(-1j * np.arange(ORDERS + 1)[:, None, None] * phases[:, EDGE:-EDGE])
    signals = np.stack([windows[..., 0], windows[..., 1:].mean(axis=2)])
    harmonics = np.einsum("kwf,swf->wks", waves, signals).reshape(len(windows), -1)
    known = np.column_stack([harmonics.real, harmonics.imag, 0.5 * np.log(squares + 1e-6)])
    codes = (
        np.linalg.svd(known - class_means @ known, full_matrices=False)[0][:, :CODE]
        * len(known) ** 0.5
    )
    # the last number is the trained phase
    codes = np.pad(codes, ((0, 0), (0, CODE + 1 - codes.shape[1])))
    conditions = np.column_stack([runs.commands, kinds])
    sizes = np.sqrt(class_means @ squares) + 1e-6
    found = {
        "windows": windows,
        "conditions": conditions,
        "phases": phases,
        "codes": codes,
        "sizes": sizes,
    }
    return {name: jnp.asarray(value, jnp.float32) for name, value in found.items()}


def _initial(num_classes: int, seed: int) -> dict[str, Any]:
    """Random weights of generator and critic, with variance 1 / inputs of a layer; zeros for biases."""
    critic: dict[str, tuple[int, ...]] = {"w_out": (4 * CRITIC_WIDTH,)}
    for layer in range(CRITIC_LAYERS):
        given = CRITIC_WIDTH if layer else CHANNELS + 2 + SUB + num_classes + 1
        critic |= {f"w{layer}": (CRITIC_TAPS, given, CRITIC_WIDTH), f"b{layer}": (CRITIC_WIDTH,)}
    rng = np.random.default_rng([seed, 53])
    found = {}
    for network, shapes in {
        "generator": learned_excitation.weight_shapes(num_classes),
        "critic": critic,
    }.items():
        scales = {
            n: (n[0] not in "bc") / np.sqrt(max(1, np.prod(shape[:-1])))
            for n, shape in shapes.items()
        }
        weights = {
            n: jnp.asarray(scales[n] * rng.standard_normal(s), jnp.float32)
            for n, s in shapes.items()
        }
        found[network] = weights
    return found


def _derivatives(windows: Any, xp: ModuleType = jnp) -> tuple[Any, Any, Any]:
    """Differences of the target and their differences, (B, frames - 2, 1), and of the torques (B, frames - 2, SUB)."""
    change = xp.diff(windows[..., :1], axis=1)
    torque = windows[..., 1:].reshape(len(windows), -1)
    rate = xp.diff(torque, axis=1)[:, -(windows.shape[1] - 2) * SUB :].reshape(
        len(windows), -1, SUB
    )
    return change[:, 1:], xp.diff(change, axis=1), rate


def _seen(windows: Any, own: Weights) -> Any:
    """(B, frames - 2, CHANNELS + 2 + SUB + 1 + classes) inputs of the critic: windows, `_derivatives`, conditions.

    Windows and their derivatives are scaled; derivatives are compressed, since impacts would
    outweigh all else.
    """
    sizes = own["sizes"][:, :, None, None]
    parts = [
        jnp.arcsinh(part / sizes[:, index]) for index, part in enumerate(_derivatives(windows))
    ]
    conditions = jnp.repeat(own["conditions"][:, None], windows.shape[1] - 2, axis=1)
    return jnp.concatenate([windows[:, 2:], *parts, conditions], axis=2)


def _scores(critic: Weights, signals: Any) -> tuple[Any, list[Any]]:
    """(B,) of the critic, large for windows of runs; and its inputs and hidden layers, pooled over the frames."""
    layers = [signals]
    for layer in range(CRITIC_LAYERS):
        kernel = critic[f"w{layer}"]
        matrix = kernel.reshape(-1, CRITIC_WIDTH)
        norm = jnp.sqrt(jnp.linalg.eigvalsh(matrix.T @ matrix)[-1])
        found = (
            learned_excitation.convolved(layers[-1], kernel / norm, STRIDE) + critic[f"b{layer}"]
        )
        layers.append(learned_excitation.leaky(found, jnp))
    pooled = [
        jnp.concatenate(
            [x.mean(axis=1), jnp.sqrt(x.var(axis=1) + 1e-6), x.max(axis=1), x.min(axis=1)], axis=1
        )
        for x in layers
    ]
    return pooled[-1] @ critic["w_out"] / jnp.linalg.norm(critic["w_out"]), pooled


def _loss(networks: dict[str, Any], data: Weights, key: Any) -> tuple[Any, Any]:
    """Sum of the losses of all networks for a random batch; loss of the reconstruction, and the critic's gap."""
    batch_key, code_key, noise_key = jax.random.split(key, 3)
    chosen = jax.random.randint(batch_key, (BATCH,), 0, len(data["windows"]))
    own = {name: value[chosen] for name, value in data.items()}
    codes = networks["codes"][chosen, :CODE]
    phases = own["phases"] + PHASE_UNIT * networks["codes"][chosen, CODE:]
    codes = codes + CODE_NOISE * jax.random.normal(code_key, codes.shape)
    conditions = jnp.repeat(
        jnp.concatenate([codes, own["conditions"]], axis=1)[:, None], phases.shape[1], axis=1
    )
    noise = jax.random.normal(noise_key, (*phases.shape, NOISE))
    made = learned_excitation.generator(networks["generator"], phases, conditions, noise, jnp)
    real = _seen(own["windows"], own)
    fake = _seen(made, own)

    score_of_real, layers = _scores(networks["critic"], real)
    score_of_fake, _ = _scores(networks["critic"], jax.lax.stop_gradient(fake))
    hinge = jnp.mean(jax.nn.relu(1.0 - score_of_real)) + jnp.mean(jax.nn.relu(1.0 + score_of_fake))

    score, layers_of_fake = _scores(jax.lax.stop_gradient(networks["critic"]), fake)
    pairs = zip(layers_of_fake, jax.lax.stop_gradient(layers), strict=True)
    matching = sum(jnp.mean(jnp.abs(one - other)) for one, other in pairs)
    apart = fake - real
    mean_torque = apart[..., 1:CHANNELS].mean(axis=2, keepdims=True)
    parts = jnp.concatenate(
        [apart[..., :1], apart[..., CHANNELS : CHANNELS + 2], mean_torque], axis=2
    )
    reconstruction = jnp.mean(jnp.abs(parts), axis=(0, 1)) @ jnp.array(RECONSTRUCTION)
    total = hinge + reconstruction + MATCHING * matching - jnp.mean(score)
    return total, jnp.stack([reconstruction, score_of_real.mean() - score_of_fake.mean()])
