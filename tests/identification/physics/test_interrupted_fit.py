"""A fit that was interrupted anywhere continues at the descent that was interrupted."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from motorprior.identification.checkpoint import Arrays, parts_of
from motorprior.identification.physics.motor_fit import MotorFits, fit_motors
from motorprior.identification.physics.motor_problem import grey_box, initial_center
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

Data = Callable[..., TrainingData]
PRESET = replace(PRESETS["per_motor"], warm_up=60)


class Saved:
    """Saved parts by name, and how many were computed; ends a run at a number of parts."""

    def __init__(self) -> None:
        self.arrays: dict[str, Arrays] = {}
        self.computed = 0
        self.interrupted_at = -1

    def __call__(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        if name not in self.arrays:
            if self.computed == self.interrupted_at:
                raise KeyboardInterrupt
            self.arrays[name] = compute()
            self.computed += 1
        return self.arrays[name]


@pytest.fixture(scope="module")
def runs(decoder_data: Data) -> WindowRuns:
    box = grey_box(initial_center(()), (), PRESET)
    z = np.random.default_rng(3).normal(0.0, 0.2, (2, box.num_latents))
    return WindowRuns(decoder_data(box, z, rows=400), PRESET)


def fitted(runs: WindowRuns, saved: Saved) -> MotorFits:
    parts = parts_of("motors", saved)
    return fit_motors(runs, (), together=True, seed=0, restarts=4, checkpoint=parts)


def test_a_continued_fit_repeats_no_finished_descent_and_ends_at_the_same_bytes(runs: WindowRuns):
    whole = Saved()
    expected = fitted(runs, whole)

    assert whole.computed > 10

    saved = Saved()
    for interrupted_at in (2, 7, whole.computed - 1):
        saved.interrupted_at = interrupted_at
        with pytest.raises(KeyboardInterrupt):
            fitted(runs, saved)

        assert saved.computed == interrupted_at

    saved.interrupted_at = -1
    fits = fitted(runs, saved)

    assert saved.computed == whole.computed
    np.testing.assert_array_equal(fits.outputs, expected.outputs)
    np.testing.assert_array_equal(fits.loss, expected.loss)
