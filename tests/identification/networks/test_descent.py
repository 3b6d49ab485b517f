"""An interrupted descent ends at the same bytes."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from series import complete

from motorprior.identification.networks.descent import CHUNK, descend
from motorprior.identification.networks.network import Parameters
from motorprior.identification.presets import PRESETS
from motorprior.identification.train import _initial
from motorprior.identification.training_data.windows import Measured, TrainingData

PRESET = replace(
    PRESETS["paper"], taps=(0, 1), num_neurons=4, num_latents=2, batch=32, steps=6 * CHUNK, learning_rate=3e-3
)  # fmt: skip


def data(rows: int = 300) -> TrainingData:
    """A spring and a damper with noise."""
    rng = np.random.default_rng(0)
    series = complete(rng.normal(0.0, 0.3, (2, rows, 7)).astype(np.float32))
    series[..., 3] = 2.0 * (series[..., 0] - series[..., 1]) - 0.1 * series[..., 2]
    scales = {"error_scale": 0.4, "velocity_scale": 0.3, "torque_scale": 0.9, "torque_limit": 5.0}
    return TrainingData(series, np.arange(rows - 1), (slice(0, rows),), scales, Measured(True))


def start() -> Parameters:
    return _initial(data(), PRESET, np.random.default_rng(0))


def as_bytes(trained: Parameters) -> bytes:
    return b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(trained))


class Kept:
    """Checkpoints in memory."""

    def __init__(self):
        self.state, self.count = None, 0

    def load(self):
        return self.state

    def save(self, state):
        self.state, self.count = {name: np.array(value) for name, value in state.items()}, self.count + 1


class Interrupted(Exception):
    """Raised by the report."""


def test_an_interrupted_descent_ends_at_the_same_bytes():
    kept, calls, stop = Kept(), 0, 6

    def report(steps: int, text: str) -> None:
        nonlocal calls
        calls += 1
        if calls == stop:
            raise Interrupted

    whole, losses = descend(start(), data(), PRESET, 3)
    with pytest.raises(Interrupted):
        descend(start(), data(), PRESET, 3, report, kept)
    assert kept.count == (stop > 5)
    again, same = descend(start(), data(), PRESET, 3, checkpoints=kept)
    assert as_bytes(again) == as_bytes(whole)
    np.testing.assert_array_equal(same, losses)
