"""What a fit leaves out of a log adds up to the log."""

import re
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


def test_the_numbers_add_up():
    numbers = [float(number) for number in re.findall(r"([0-9.]+) s\b", used_share(data((900, 400, 3000)), RECIPE))]
    assert abs(numbers[0] + sum(numbers[2:]) - numbers[1]) < 0.2


def test_what_stands_still_is_said():
    assert used_share(data((2121,), 0), RECIPE).count("still") == 0
    assert used_share(data((2121,), 1200), RECIPE).endswith("; 2.0 s of what is fitted stand still")


def test_windows_anywhere_leave_no_ends():
    said = used_share(data((2000,)), replace(RECIPE, physics_first=""))
    assert said.startswith("fitted to 3.8 s of 4.0 s of log; left out: 0.2 s at the beginnings of segments")
