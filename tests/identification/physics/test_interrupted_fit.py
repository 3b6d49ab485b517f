"""A fit that was interrupted anywhere continues at the descent that was interrupted."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motorprior as mp
from motorprior.identification.checkpoint import Arrays, parts_of
from motorprior.identification.physics.motor_fit import MotorFits, fit_motors
from motorprior.identification.physics.motor_problem import grey_box, initial_center
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.search import Fit, Search
from motorprior.identification.windows import TrainingData
from motorprior.priors import fit_prior as fit_prior_module
from motorprior.progress import SILENT

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


def test_a_fit_in_a_folder_continues_after_an_interruption_at_any_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    log = mp.record_bench(motors=2, steps=600, preset="rollout")
    descend = Search._descend
    descents = 0
    interrupted_at = -1

    def counted(self: Search, *arguments: Any) -> Fit:
        nonlocal descents
        if descents == interrupted_at:
            raise KeyboardInterrupt
        descents += 1
        return descend(self, *arguments)

    monkeypatch.setattr(Search, "_descend", counted)
    monkeypatch.setattr(fit_prior_module, "MIN_SAVED", 0.0)
    whole = mp.fit_prior(log, "pace", progress=SILENT)
    descents_of_whole = descents

    descents = 0
    interruptions = (5, 9, 14)
    for number in interruptions:
        interrupted_at = number
        with pytest.raises(KeyboardInterrupt):
            mp.fit_prior(log, "pace", out=tmp_path, progress=SILENT)

    interrupted_at = -1
    continued = mp.fit_prior(log, "pace", out=tmp_path, progress=SILENT)

    assert continued.mean.tobytes() == whole.mean.tobytes()
    assert list(tmp_path.glob("unfinished*")) == []
    # only the interrupted steps of the search are repeated: a few descents of more than a hundred
    repeated = descents - descents_of_whole

    assert descents_of_whole > 100
    assert 0 < repeated < 0.2 * descents_of_whole
