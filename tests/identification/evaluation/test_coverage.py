"""Bands of samples have their nominal coverage, and coverage is counted correctly."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorprior.identification.evaluation import coverage as module
from motorprior.identification.evaluation.coverage import DRAWS, band, coverage


@pytest.mark.parametrize("level", [50, 90])
@pytest.mark.parametrize("kind", ["normal", "exponential"])
def test_a_band_of_few_samples_has_its_nominal_coverage(level: int, kind: str):
    rng = np.random.default_rng(level)
    sample = getattr(rng, "standard_" + kind)((DRAWS + 1, 200, 100))
    low, high = band(sample[:-1], level)
    inside = np.mean((sample[-1] >= low) & (sample[-1] <= high))
    assert inside == pytest.approx(level / 100, abs=0.01)  # 20,000 trials: three standard errors


ANSWERS = {
    ("sine", 0): [[20.0, 35.0], [1.0, 39.0]],  # one of four in the 50 % band, two in the 90 % band
    ("sine", 1): [[20.0, 20.0], [11.0, 30.0]],  # all in both
    ("gait", 0): [[100.0, -100.0], [40.0, 0.0]],  # none
    ("gait", 1): [[3.0, 3.0], [31.0, 38.0]],  # none in the 50 % band, all in the 90 % band
}
"""Angles (2 steps, 2 motors). Forty draws of 1, 2, … 40 have bands from 10.25 to 30.75 and from 2.05 to 38.95."""


def test_coverage_equals_a_count_by_hand(monkeypatch: pytest.MonkeyPatch):
    nothing: Any = None
    ramp = np.arange(1.0, DRAWS + 1.0)[:, None, None] * np.ones((DRAWS, 2, 2))

    def cases(kind: str, motors: int, *_: object) -> list[tuple[str, int]]:
        assert motors == 2
        return [(kind, repeat) for repeat in range(3)]  # only two are replayed

    def answer(seconds: float, case: tuple[str, int]) -> SimpleNamespace:
        assert seconds == 10.0 * case[1]  # how long the motors have worked before this very trial
        return SimpleNamespace(joint_pos=np.array(ANSWERS[case]))

    class Motors:
        def __len__(self) -> int:
            return 2

        def after(self, seconds: float) -> SimpleNamespace:
            return SimpleNamespace(actuator=lambda: seconds)

    monkeypatch.setattr(module, "held_out_trials", cases)
    monkeypatch.setattr(module, "seconds_of_work", lambda *_: np.array([0.0, 10.0, 20.0]))
    monkeypatch.setattr(module, "predictive_draws", lambda *_: ramp)
    monkeypatch.setattr(module, "run", answer)
    motors, preset = Motors(), SimpleNamespace(kinds=("sine", "gait"))
    found = coverage(nothing, {}, nothing, motors, 0, preset)  # pyright: ignore[reportArgumentType]
    shares = {(row.quantity, row.part): row.value for row in found}
    assert shares == {
        ("coverage50", None): 0.3125,
        ("coverage90", None): 0.625,
        ("coverage50", "sine"): 0.625,
        ("coverage90", "sine"): 0.75,
        ("coverage50", "gait"): 0.0,
        ("coverage90", "gait"): 0.5,
    }
