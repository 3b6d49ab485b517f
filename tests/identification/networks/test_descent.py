"""A descent that diverges restarts at a lower rate; an interrupted one ends at the same bytes."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from series import complete

from motorprior.identification.networks import descent
from motorprior.identification.networks.descent import CHUNK, SLOWER, descend
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


def diverging(monkeypatch: pytest.MonkeyPatch, attempts: int, broken: float = np.nan, where: int = 3) -> list[float]:
    """Replace the training so that the first ``attempts`` diverge in chunk ``where``; lists their rates."""
    rates: list[float] = []

    def compiled(data, preset, optimiser):
        rates.append(preset.learning_rate)
        calls = 0

        def chunk(state, inputs):
            nonlocal calls
            calls += 1
            return state, broken if calls == where and len(rates) <= attempts else 1.0 - 0.01 * calls, 1.0

        return chunk

    monkeypatch.setattr(descent, "_compiled_chunk", compiled)
    return rates


@pytest.mark.parametrize(("broken", "where"), [(np.nan, 1), (10.0, 3)])
def test_a_training_that_diverges_restarts_at_a_third_of_the_rate(
    monkeypatch: pytest.MonkeyPatch, broken: float, where: int
):
    rates, reports = diverging(monkeypatch, 2, broken, where), []
    _, losses = descend(start(), data(), PRESET, 0, lambda *what: reports.append(what))
    assert rates == pytest.approx([PRESET.learning_rate / SLOWER**k for k in range(3)])
    np.testing.assert_allclose(losses, 1.0 - 0.01 * np.arange(1, 7))
    assert sum(steps for steps, _ in reports) == PRESET.steps


@pytest.mark.parametrize("stop", [6])
def test_an_interrupted_descent_ends_at_the_same_bytes(stop: int):
    kept, calls = Kept(), 0

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
