"""A residual network is tested on rows on which it was not trained."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.term_selection import held_out_windows
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.residual import train_starts
from motorprior.identification.training_data.windows import TrainingData

Networks = Callable[..., LatentNetwork]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["rollout"], taps=(0, 2, 5), own_latents=False, num_latents=3, warm_up=60, window=32)
Z = np.array([[0.5, -1.0, 0.3], [0.0, 0.3, -0.8]])


@pytest.mark.parametrize(("lengths", "window"), [([700], 32), ([400] * 10, 32), ([300, 900, 50, 600], 100)])
def test_no_test_row_is_trained_on(grey_network: Networks, decoder_data: Data, lengths: list[int], window: int):
    ends, longer = np.cumsum(lengths), replace(PRESET, window=window)
    parts = tuple(slice(end - length, end) for end, length in zip(ends, lengths, strict=True))
    data = replace(decoder_data(grey_network(), Z, segments=1, rows=int(ends[-1])), parts=parts)
    test, grid = held_out_windows(WindowRuns(data, longer)), []
    for part in parts:
        count = max(0, (part.stop - part.start - 1 - PRESET.history) // window)
        grid += [part.start + PRESET.history + index * window for index in range(count)]
    starts = train_starts(data, PRESET, longer, test)
    trained = (starts[:, None] + PRESET.history + np.arange(PRESET.window)).ravel()
    rows = np.array(grid)[:, None] + np.arange(window)
    assert not np.isin(rows[test], trained).any() and np.isin(rows[~test], trained).all()
    assert all(
        any(part.start <= start and start + PRESET.history + PRESET.window < part.stop for part in parts)
        for start in starts
    )
