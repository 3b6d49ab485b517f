"""Size of the fast content of signals."""

import numpy as np


def high_frequency_rms(signal: np.ndarray, period: float, cutoff: float) -> np.ndarray:
    """RMS of the content of a signal above ``cutoff`` [Hz], by Parseval's theorem.

    The signal has the shape (time, ...) and the sample ``period`` [s]; the result has (...).
    """
    count = signal.shape[0]
    spectrum = np.fft.rfft(signal - signal.mean(axis=0), axis=0)
    power = np.abs(spectrum) ** 2
    power[1 : (count + 1) // 2] *= 2.0
    above = np.fft.rfftfreq(count, period) > cutoff
    return np.sqrt(power[above].sum(axis=0)) / count
