"""What a fit leaves out of a log adds up to the log."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from motorprior.identification.presets import PRESETS
from motorprior.identification.training_data.used_share import used_share
from motorprior.identification.training_data.windows import CHANNELS, POS, TARGET, VEL, Measured, TrainingData

RECIPE = replace(PRESETS["rollout"], warm_up=120, window=500)


def data(lengths: tuple[int, ...], still: int = 0) -> TrainingData:
    """Two joints in motion, but for the first rows, in segments of these rows."""
    rows = sum(lengths)
    series, moving = np.zeros((2, rows, CHANNELS), np.float32), np.arange(rows) >= still
    series[..., TARGET] = series[..., POS] = np.where(moving, np.sin(0.05 * np.arange(rows)), 0.0)
    series[..., VEL] = np.where(moving, 1.0, 0.0)
    edges = np.cumsum((0, *lengths))
    parts = tuple(slice(int(a), int(b)) for a, b in pairwise(edges))
    return TrainingData(series, np.arange(rows), parts, {}, Measured(False))


def test_every_second_is_fitted_or_has_a_reason():
    said = used_share(data((621, 620, 2000)), RECIPE)
    assert said == (
        "fitted to 4.0 s of 6.5 s of log; left out: 1.2 s in 1 segments shorter than a window, 0.5 s at the beginnings "
        "of segments, where hidden states settle, 0.8 s at their ends, less than a window"
    )
