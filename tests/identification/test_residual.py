"""A residual network is worth what it saves where it was not trained."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.actuator.latent import LatentNetwork
from motorprior.identification.physics.term_selection import held_out_windows
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.residual import FittedMotors, saved_by_residual, train_starts, without_residual
from motorprior.identification.training_data.windows import TrainingData

Networks = Callable[..., LatentNetwork]
Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["rollout"], taps=(0, 2, 5), own_latents=False, num_latents=3, warm_up=60, window=32)
Z = np.array([[0.5, -1.0, 0.3], [0.0, 0.3, -0.8]])


@pytest.fixture(scope="module")
def machines(grey_network: Networks, decoder_data: Data) -> tuple[LatentNetwork, LatentNetwork, WindowRuns]:
    """Physics alone, the same with the network that made the log, and the log."""
    whole = grey_network(network=0.4, terms=("output_damping",))
    bare = without_residual({n: getattr(whole, n) for n in SCALES}, PRESET)
    return replace(bare, motor=whole.motor), whole, WindowRuns(decoder_data(whole, Z), PRESET)


SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")


def test_the_network_that_made_the_log_saves_nearly_everything(machines):
    bare, whole, runs = machines
    every = np.ones(runs.windows, bool)
    loss, position = saved_by_residual(FittedMotors(bare, Z), FittedMotors(whole, Z), runs, every)
    assert loss > 0.9 and position > 0.8
    back = saved_by_residual(FittedMotors(whole, Z), FittedMotors(bare, Z), runs, every)
    np.testing.assert_allclose([1 - back[0], 1 - back[1]], [1 / (1 - loss), 1 / (1 - position)], rtol=1e-3)
    np.testing.assert_allclose(
        saved_by_residual(FittedMotors(bare, Z), FittedMotors(bare, Z), runs, every), 0.0, atol=1e-12
    )


@pytest.mark.parametrize(("lengths", "window"), [([700], 32), ([400] * 10, 32), ([300, 900, 50, 600], 100)])
def test_no_judged_row_is_trained_on(grey_network: Networks, decoder_data: Data, lengths: list[int], window: int):
    ends, longer = np.cumsum(lengths), replace(PRESET, window=window)
    parts = tuple(slice(end - length, end) for end, length in zip(ends, lengths, strict=True))
    data = replace(decoder_data(grey_network(), Z, segments=1, rows=int(ends[-1])), parts=parts)
    judged, grid = held_out_windows(WindowRuns(data, longer)), []
    for part in parts:
        count = max(0, (part.stop - part.start - 1 - PRESET.history) // window)
        grid += [part.start + PRESET.history + index * window for index in range(count)]
    starts = train_starts(data, PRESET, longer, judged)
    trained = (starts[:, None] + PRESET.history + np.arange(PRESET.window)).ravel()
    rows = np.array(grid)[:, None] + np.arange(window)
    assert not np.isin(rows[judged], trained).any() and np.isin(rows[~judged], trained).all()
    assert all(
        any(part.start <= start and start + PRESET.history + PRESET.window < part.stop for part in parts)
        for start in starts
    )
