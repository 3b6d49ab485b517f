"""Raw streams of joints from the windows of runs: played themselves, as surrogates with their spectrum, or generated.

A frame is one control period: a position target, and SUB external torques. Raw streams are not bounded yet.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from motorprior.bench.learned_excitation import LearnedExcitation

SUB = 5  # external torques per frame
CHANNELS = 1 + SUB
FADE = 10  # frames of a cross-fade between two windows
NOISE, STYLE = 6, 4  # random inputs of the generator per frame, and slow ones
STYLE_FRAMES = 250  # after which the slow inputs have changed
HARMONICS = 2  # of the gait's phase that the generator gets
TAPS, DILATIONS = 5, (1, 3, 9)  # of the generator's convolutions
RECEPTIVE = 1 + (TAPS - 1) * sum(DILATIONS)  # frames that one output depends on
LEAK = 0.2  # slope of the activations for negative inputs
_MIN_SURROGATE = 4096  # frames over which a surrogate has the marginals of the runs


def recorded(runs: LearnedExcitation, rng: np.random.Generator, frames: int, which: np.ndarray) -> np.ndarray:
    """(frames, n, CHANNELS) random windows of each joint's class, one after the other, with cross-faded seams."""
    length = runs.windows.shape[1] - FADE
    rising = 0.5 - 0.5 * np.cos(np.pi * (np.arange(FADE) + 0.5) / FADE)
    weight = np.concatenate([rising, np.ones(length - FADE), rising[::-1]])[:, None]
    count = -(-(frames + FADE) // length)
    out = np.zeros((count * length + FADE, len(which), CHANNELS))
    for joint, kind in enumerate(which):
        for slot, window in enumerate(rng.choice(np.flatnonzero(runs.window_class == kind), count)):
            out[slot * length : (slot + 1) * length + FADE, joint] += weight * runs.windows[window]
    return out[FADE : FADE + frames]


def surrogate(runs: LearnedExcitation, rng: np.random.Generator, frames: int, which: np.ndarray) -> np.ndarray:
    """(frames, n, CHANNELS) Gaussian processes with the cross-spectra of each joint's class, then its marginals.

    Phase-randomised surrogates (Theiler et al., Physica D 58, 1992) of the mean cross-spectrum of the windows,
    mapped by rank to the windows' values, channel by channel.
    """
    total, out = max(frames, _MIN_SURROGATE), np.empty((frames, len(which), CHANNELS))
    for kind in np.unique(which):
        windows = runs.windows[runs.window_class == kind]
        spectra = np.fft.rfft(np.hanning(windows.shape[1])[:, None] * windows, axis=1)
        cross = np.einsum("wfi,wfj->fij", spectra, spectra.conj()) / len(windows)
        at = np.linspace(0.0, len(cross) - 1.0, total // 2 + 1)
        low = np.minimum(at.astype(int), len(cross) - 2)
        share = (at - low)[:, None, None]
        dense = (1.0 - share) * cross[low] + share * cross[low + 1]
        scale = np.einsum("fii->fi", dense).real.max(axis=0)
        factor = np.linalg.cholesky(dense + 1e-6 * np.diag(scale + 1e-12))
        values = np.sort(windows.reshape(-1, CHANNELS), axis=0)
        levels = np.linspace(0, len(values) - 1, total).astype(int)
        for joint in np.flatnonzero(which == kind):
            noise = rng.standard_normal((2, total // 2 + 1, CHANNELS))
            process = np.fft.irfft(np.einsum("fij,fj->fi", factor, noise[0] + 1j * noise[1]), n=total, axis=0)
            ranks = process.argsort(axis=0).argsort(axis=0)
            out[:, joint] = np.take_along_axis(values[levels], ranks, axis=0)[:frames]
    return out


def generated(runs: LearnedExcitation, rng: np.random.Generator, frames: int, which: np.ndarray) -> np.ndarray:
    """(frames, n, CHANNELS) of the generator: convolutions of endless random inputs, hence without seams."""
    inputs, _ = generator_inputs(runs, rng, frames + RECEPTIVE - 1, which)
    return np.moveaxis(generator(runs.weights, inputs) * runs.scales[which][:, None], 0, 1)


def generator_inputs(
    runs: LearnedExcitation, rng: np.random.Generator, frames: int, which: np.ndarray, style_frames: int = STYLE_FRAMES
) -> tuple[np.ndarray, np.ndarray]:
    """(n, frames, inputs) random inputs and conditions, and the (n,) windows whose commands the streams begin with.

    Every ``style_frames`` a random window of the joint's class gives gait command and gait frequency, whose phase goes
    in as sines, and the slow inputs have moved on to other random values.
    """
    knots, joints = frames // style_frames + 2, len(which)
    chosen = np.stack([rng.choice(np.flatnonzero(runs.window_class == kind), knots) for kind in which])
    levels = rng.standard_normal((joints, knots, STYLE))
    at = np.arange(frames) // style_frames
    share = (np.arange(frames) / style_frames - at)[:, None]
    style = (1.0 - share) * levels[:, at] + share * levels[:, at + 1]
    style /= np.sqrt((1.0 - share) ** 2 + share**2)
    phase = 2 * np.pi * (rng.random((joints, 1)) + runs.period * np.cumsum(runs.frequency[chosen][:, at], axis=1))
    waves = [wave(order * phase)[..., None] for order in range(1, HARMONICS + 1) for wave in (np.sin, np.cos)]
    kinds = np.broadcast_to(np.eye(len(runs.classes))[which][:, None], (joints, frames, len(runs.classes)))
    noise = rng.standard_normal((joints, frames, NOISE))
    parts = [noise, style, *waves, kinds, runs.commands[chosen][:, at][..., None]]
    return np.concatenate(parts, axis=2), chosen[:, 0]


def num_inputs(num_classes: int) -> int:
    """Inputs per frame of the generator."""
    return NOISE + STYLE + 2 * HARMONICS + num_classes + 1


def generator(weights: Mapping[str, Any], inputs: Any, xp: ModuleType = np) -> Any:
    """(n, frames - RECEPTIVE + 1, CHANNELS) scaled raw streams of inputs (n, frames, inputs); also for JAX."""
    hidden = inputs
    for layer, dilation in enumerate(DILATIONS):
        found = convolved(hidden, weights[f"w{layer}"], dilation) + weights[f"b{layer}"]
        found = xp.where(found > 0.0, found, LEAK * found)
        reach = dilation * (TAPS - 1) // 2
        hidden = found + hidden[:, reach:-reach] if layer else found
    return hidden @ weights["w_out"] + weights["b_out"]


def convolved(signal: Any, kernel: Any, dilation: int = 1, stride: int = 1) -> Any:
    """Convolution of (n, frames, inputs) with (taps, inputs, outputs), without padding."""
    count = signal.shape[1] - dilation * (kernel.shape[0] - 1)
    return sum(
        signal[:, tap * dilation : tap * dilation + count : stride] @ kernel[tap] for tap in range(kernel.shape[0])
    )


MAKERS = {"generated": generated, "surrogate": surrogate, "recorded": recorded}
