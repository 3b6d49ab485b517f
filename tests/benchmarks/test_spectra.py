"""The fast content of a signal agrees with its closed form."""

import numpy as np
import pytest

from spectra import high_frequency_rms

PERIOD = 0.002  # [s]


@pytest.mark.parametrize("count", [500, 501])
def test_a_sine_above_the_cutoff_counts_with_amplitude_over_root_two(count: int):
    time = np.arange(count) * PERIOD
    # whole periods, so no leakage: 10 and 60 Hz
    low = 10 / (count * PERIOD)
    high = 60 / (count * PERIOD)
    slow = 0.7 * np.sin(2 * np.pi * low * time)
    fast = 0.2 * np.sin(2 * np.pi * high * time + 0.3)
    signal = 5.0 + slow + fast

    assert high_frequency_rms(signal, PERIOD, 30.0) == pytest.approx(0.2 / np.sqrt(2))
    assert high_frequency_rms(signal, PERIOD, 1.0) == pytest.approx(np.hypot(0.7, 0.2) / np.sqrt(2))
    assert high_frequency_rms(signal, PERIOD, 100.0) == pytest.approx(0.0, abs=1e-12)
