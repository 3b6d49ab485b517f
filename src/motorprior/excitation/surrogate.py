"""Streams of a Gaussian process with the spectra and the marginals of the windows of runs."""

import numpy as np

from motorprior.excitation.excitation import Rng
from motorprior.excitation.frames import CHANNELS

MIN_FRAMES = 4096  # frames over which a surrogate has the marginals of the runs
NUM_MIXED = 64  # windows whose spectra are mixed


def surrogate_stream(windows: np.ndarray, rng: Rng, num_frames: int) -> np.ndarray:
    """(num_frames, CHANNELS) Gaussian process with the windows' cross-spectra and marginals.

    Phase-randomised surrogate (Theiler et al., Physica D 58, 1992): a sum of the spectra of windows
    with random complex weights at every frequency, mapped by rank to the windows' values, channel
    by channel.
    """
    total = max(num_frames, MIN_FRAMES)
    process = _process(windows, rng, total)

    values = np.sort(windows.reshape(-1, CHANNELS), axis=0)
    levels = np.linspace(0, len(values) - 1, total).astype(int)
    ranks = process.argsort(axis=0).argsort(axis=0)
    return np.take_along_axis(values[levels], ranks, axis=0)[:num_frames]


def _process(windows: np.ndarray, rng: Rng, total: int) -> np.ndarray:
    """(total, CHANNELS) Gaussian process with the cross-spectra of NUM_MIXED random windows."""
    mixed = rng.permutation(windows)[:NUM_MIXED]
    spectra = np.fft.rfft(np.hanning(windows.shape[1])[:, None] * mixed, axis=1)
    bins = np.linspace(0.0, spectra.shape[1] - 1.0, total // 2 + 1).round().astype(int)

    real, imaginary = rng.standard_normal((2, len(bins), len(mixed)))
    spectrum = np.einsum("fw,wfi->fi", real + 1j * imaginary, spectra[:, bins])
    return np.fft.irfft(spectrum, n=total, axis=0)
