"""Which foot touches down after which, and that every gait is its own mirror image."""

import numpy as np
import pytest

from motorprior.locomotion.body import GAITS, GaitName, phases_of
from motorprior.locomotion.trajectory_generator import advance_phase, foot_path
from motorprior.robots.pupper_v2.robot import PUPPER_V2

TOUCH_DOWNS = {
    "trot": [{"FR", "RL"}, {"FL", "RR"}],
    "walk": [{"RL"}, {"FL"}, {"RR"}, {"FR"}],
    "pace": [{"FR", "RR"}, {"FL", "RL"}],
    "bound": [{"FR", "FL"}, {"RR", "RL"}],
    "pronk": [{"FR", "FL", "RR", "RL"}],
}
"""In the order of time, from phase 0."""


def stance_and_touch_downs(gait: GaitName) -> tuple[np.ndarray, list[set[str]]]:
    """(steps, legs) whether each foot is down, over a cycle of 400 steps from phase 0, and who comes down when."""
    phases, ratio = phases_of(PUPPER_V2, gait)
    names, share = [leg.name for leg in PUPPER_V2.legs], 1.0 / (1.0 + ratio)
    cycle = (np.arange(400) + 0.5) / 400
    down = np.array([[foot_path(float((phase + own) % 1.0), share)[1] == 0.0 for own in phases] for phase in cycle])
    touched = down & ~np.roll(down, 1, axis=0)
    order = [{names[leg] for leg in np.flatnonzero(row)} for row in touched if row.any()]
    return down, order


@pytest.mark.parametrize("gait", GAITS)
def test_feet_touch_down_in_the_order_of_the_gait(gait: GaitName):
    down, order = stance_and_touch_downs(gait)
    assert order == TOUCH_DOWNS[gait]
    np.testing.assert_allclose(down.mean(axis=0), 0.75 if gait == "walk" else 0.5, atol=0.005)


def test_phase_advances_and_wraps():
    assert advance_phase(0.2, 1.25, 0.01) == pytest.approx(0.2125)
    assert advance_phase(0.99, 2.0, 0.01) == pytest.approx(0.01)
    phase = 0.0
    for _ in range(1000):  # 10 s at 1.3 Hz: 13 cycles
        phase = advance_phase(phase, 1.3, 0.01)
        assert 0.0 <= phase < 1.0
    assert min(phase, 1.0 - phase) == pytest.approx(0.0, abs=1e-9)
