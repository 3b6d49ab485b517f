"""Streams of a generator network, which `train_generator` trains on the windows of runs.

The network is written once for numpy, which plays it, and for JAX, which trains it (argument
``xp``).
"""

from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from motorprior.excitation.excitation import Rng
from motorprior.excitation.frames import CHANNELS, TORQUES_PER_FRAME

# A stream changes its gait every GAIT_FRAMES frames, within TRANSITION frames.
GAIT_FRAMES = 250
TRANSITION = 25
NEIGHBOURS = 8  # windows with a similar gait, one of which is mixed with a window
# inputs of the network
NOISE = 10  # Gaussian noise per frame
CODE_SIZE = 12  # numbers of a window's code
HARMONICS = 10  # harmonics of the gait's phase
# embedding of the gait's phase and of the conditioning inputs
LAYERS = 3
EMBEDDING = 96  # channels
# convolutions
NUM_HIDDEN = 32  # channels
TAPS = 5
DILATIONS = (1, 3)
TARGET_NOISE = 0.1  # factor of the convolutions in the target, which is smooth
EDGE = (TAPS - 1) * sum(DILATIONS) // 2  # frames before and after an output that it depends on
LEAK = 0.2  # slope of the activations for negative inputs


def generated_stream(
    weights: Mapping[str, np.ndarray],
    gaits: np.ndarray,
    class_code: np.ndarray,
    period: float,
    rng: Rng,
    num_frames: int,
) -> np.ndarray:
    """(num_frames, CHANNELS) scaled stream: convolutions of endless inputs, hence without seams.

    Every GAIT_FRAMES the gait changes: frequency, code and commanded speed between those of two
    similar windows.

    Args:
        weights: of the network, see `weight_shapes`.
        gaits: (windows of the class, 1 + CODE_SIZE + 1) logarithm of the frequency [Hz], code, and
            commanded speed [m/s].
        class_code: (classes,) 1 at the class of the stream, 0 elsewhere.
        period: of a frame [s].
        rng: of gaits, phase and noise.
        num_frames: length of the stream.
    """
    total = num_frames + 2 * EDGE
    offset = rng.integers(GAIT_FRAMES)
    gait_number, frames_since_change = np.divmod(np.arange(total) + offset, GAIT_FRAMES)
    played = _mixed_gaits(gaits, rng, gait_number[-1] + 2)

    progress = np.minimum((frames_since_change + 0.5) / TRANSITION, 1.0)
    share = 0.5 - 0.5 * np.cos(np.pi * progress)[:, None]
    gait = (1.0 - share) * played[gait_number] + share * played[gait_number + 1]

    frequency = np.exp(gait[:, 0])
    phase = 2 * np.pi * (rng.random() + period * np.cumsum(frequency))
    conditioning = np.column_stack([gait[:, 1:], np.tile(class_code, (total, 1))])
    noise = rng.standard_normal((1, total, NOISE))
    return generator(weights, phase[None], conditioning[None], noise)[0]


def _mixed_gaits(gaits: np.ndarray, rng: Rng, count: int) -> np.ndarray:
    """(count, K) random points between a row of ``gaits`` (n, K) and one of its nearest rows."""
    first = rng.integers(len(gaits), size=count)
    share = rng.uniform(0.0, 0.5, (count, 1))

    distance = np.linalg.norm((gaits[first, None] - gaits) / (gaits.std(axis=0) + 1e-9), axis=2)
    nearest = np.argsort(distance, axis=1)[:, : NEIGHBOURS + 1]
    second = rng.permuted(nearest, axis=1)[:, 0]
    return (1.0 - share) * gaits[first] + share * gaits[second]


def generator(
    weights: Mapping[str, Any], phase: Any, conditioning: Any, noise: Any, xp: ModuleType = np
) -> Any:
    """(n, frames - 2 EDGE, CHANNELS) scaled streams; also for JAX.

    An embedding of phase and conditioning inputs, frame by frame, gives mean target and torques.
    Gated convolutions of embedding and noise add oscillations.

    Args:
        weights: see `weight_shapes`.
        phase: (n, frames) of the gait [rad].
        conditioning: (n, frames, CODE_SIZE + 1 + classes) the code, the commanded speed, the class.
        noise: (n, frames, NOISE) Gaussian.
        xp: numpy or jax.numpy.
    """
    waves = []
    for order in range(1, HARMONICS + 1):
        waves.append(xp.sin(order * phase)[..., None])
        waves.append(xp.cos(order * phase)[..., None])
    embedding = xp.concatenate([*waves, conditioning], axis=2)
    for layer in range(LAYERS):
        embedding = leaky(embedding @ weights[f"v{layer}"] + weights[f"c{layer}"], xp)

    hidden = xp.concatenate([embedding, noise], axis=2)
    for layer, dilation in enumerate(DILATIONS):
        output = convolved(hidden, weights[f"w{layer}"], dilation) + weights[f"b{layer}"]
        signal = output[..., :NUM_HIDDEN]
        gate = 0.5 + 0.5 * xp.tanh(0.5 * output[..., NUM_HIDDEN:])
        gated = signal * gate

        reach = dilation * (TAPS - 1) // 2
        hidden = gated + hidden[:, reach:-reach] if layer else gated

    mean = embedding[:, EDGE:-EDGE] @ weights["w_skip"] + weights["b_out"]
    oscillation_factors = xp.array([TARGET_NOISE] + TORQUES_PER_FRAME * [1.0])
    return mean + (hidden @ weights["w_out"]) * oscillation_factors


def leaky(signal: Any, xp: ModuleType = np) -> Any:
    """``signal``, its negative values times LEAK."""
    return xp.where(signal > 0.0, signal, LEAK * signal)


def convolved(signal: Any, kernel: Any, dilation: int = 1) -> Any:
    """Convolution of (n, frames, inputs) with (taps, inputs, outputs), without padding."""
    count = signal.shape[1] - dilation * (len(kernel) - 1)
    return sum(signal[:, tap * dilation :][:, :count] @ kernel[tap] for tap in range(len(kernel)))


def weight_shapes(num_classes: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the generator's weights by name."""
    shapes: dict[str, tuple[int, ...]] = {
        "w_skip": (EMBEDDING, CHANNELS),
        "w_out": (NUM_HIDDEN, CHANNELS),
        "b_out": (CHANNELS,),
    }

    num_inputs = 2 * HARMONICS + CODE_SIZE + 1 + num_classes
    for layer in range(LAYERS):
        shapes[f"v{layer}"] = (EMBEDDING if layer else num_inputs, EMBEDDING)
        shapes[f"c{layer}"] = (EMBEDDING,)

    for layer in range(len(DILATIONS)):
        num_inputs = NUM_HIDDEN if layer else EMBEDDING + NOISE
        shapes[f"w{layer}"] = (TAPS, num_inputs, 2 * NUM_HIDDEN)
        shapes[f"b{layer}"] = (2 * NUM_HIDDEN,)
    return shapes
