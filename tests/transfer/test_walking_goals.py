"""How many policies reached a goal of training, and when."""

from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.results import Results
from walking import Settings, goals, keep

NEVER = float("inf")


def told(*times: tuple[float, float]) -> dict[str, float]:
    return {row.quantity: row.value for row in goals(times)}


def test_a_goal_has_the_median_of_its_seconds_if_half_of_the_seeds_got_there():
    found = told((1.0, 20.0), (3.0, NEVER), (2.0, 30.0))
    assert found["seconds_to_quarter_meter_per_second"] == 2.0 and found["seeds_to_quarter_meter_per_second"] == 1.0
    assert found["seconds_to_straight_quarter_meter_per_second"] == 30.0
    assert found["seeds_to_straight_quarter_meter_per_second"] == pytest.approx(2 / 3)


def test_a_goal_that_no_seed_reached_has_no_seconds_and_is_written(tmp_path: Path):
    results = Results.of(goals([(1.0, NEVER), (2.0, NEVER)]))
    assert "seconds_to_straight_quarter_meter_per_second" not in {row.quantity for row in results}
    keep(Settings(tmp_path), results)
    figures = read_json(tmp_path / "figures.json")
    assert figures["seeds_to_straight_quarter_meter_per_second"] == 0.0
    assert figures["seconds_to_quarter_meter_per_second"] == 1.5
    assert "seeds_to_straight" in (tmp_path / "tables.md").read_text("utf-8")
