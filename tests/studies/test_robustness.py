"""Robustness maps: a cell has the values of its axes, and maps do not depend on the threads."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.studies import robustness
from motorprior.studies.robustness import grids


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short episodes, few of them."""
    monkeypatch.setattr(robustness, "DURATION_STEPS", 120)
    monkeypatch.setattr(robustness, "ROBUSTNESS_DRAWS", 2)
    monkeypatch.setattr(robustness, "MASSES", (0.8, 1.0, 1.2, 4.0))


def test_a_cell_has_the_values_of_its_axes():
    (shoved, with_push), (_, with_delay) = grids(PUPPER_V2)
    push, mu = shoved.rows[-1], shoved.columns[0]
    conditions = with_push(push, mu).conditions(PUPPER_V2, 3, 300)
    assert conditions.friction * PUPPER_V2.foot_friction == pytest.approx(mu)
    impulse = np.linalg.norm(conditions.push, axis=1).max() * PUPPER_V2.control_dt
    assert 0.0 < impulse <= push
    heavy = with_delay(20.0, 1.2).conditions(PUPPER_V2, 3, 300)
    assert heavy.command_delay == pytest.approx(0.02) and heavy.mass == pytest.approx(1.2)
    nominal = with_delay(0.0, 1.0).conditions(PUPPER_V2, 3, 300)
    assert nominal.command_delay == 0.0 and (nominal.mass == 1.0).all() and len(nominal.push) == 0


def test_a_map_does_not_depend_on_the_threads_and_a_heavy_robot_falls(gait_walk: Path, small: None):
    one, two = (robustness.robustness(gait_walk / "policy.safetensors", PUPPER_V2, workers) for workers in (1, 2))
    assert one == two
    shoved, late = (np.array(each.share) for each in one)
    assert shoved.shape == late.shape == (4, 4)
    assert shoved[0, -1] == 1.0 and late[0, 1] == 1.0
    assert late[:, -1].max() < 1.0
