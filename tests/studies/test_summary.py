"""Table of the walks of a study: independent of the order of its rows, saved without loss, and its statistics."""

from pathlib import Path

import numpy as np

from motorprior.report.study import difference_table, headline_table
from motorprior.studies.summary import WalkRow, read_walks, scores, summarise, write_walks


def row(place: str, condition: str, seed: int, draw: int, **measures: float) -> WalkRow:
    return {"place": place, "condition": condition, "seed": seed, "draw": draw} | measures


def test_scores_are_sorted_by_seed_and_draw():
    walks = [row("fleet", "prior", seed, draw, speed=10 * seed + draw) for seed in (7, 3) for draw in (2, 0, 1)]
    np.testing.assert_array_equal(scores(walks, "speed"), [[30, 31, 32], [70, 71, 72]])


def test_a_saved_table_is_read_back_with_undefined_measures(tmp_path: Path):
    walks = [row("own", "prior", 3, draw, speed=0.123456, torque=float("nan")) for draw in range(2)]
    write_walks(tmp_path / "walks.csv", walks)
    found = read_walks(tmp_path / "walks.csv")
    assert [{**walk, "torque": 0} for walk in found] == [{**walk, "torque": 0} for walk in walks]
    assert all(np.isnan(walk["torque"]) for walk in found)


def invented(conditions: dict[str, float], seeds: int = 8, draws: int = 16) -> list[WalkRow]:
    """Walks in one environment, upright for a share about that of the condition."""
    rng = np.random.default_rng(0)
    return [
        row("fleet", name, seed, draw, speed=upright, upright=float(np.clip(rng.normal(upright, 0.02), 0, 1)))
        for name, upright in conditions.items()
        for seed in range(seeds)
        for draw in range(draws)
    ]


def test_a_clear_difference_is_significant_and_none_is_not():
    summary = summarise(invented({"prior": 0.9, "ideal_pd": 0.3, "pd_friction": 0.9, "pd_adapted": 0.3}))
    for condition in ("ideal_pd", "pd_adapted"):
        found = summary.differences["fleet", condition, "upright"]
        assert found.p < 0.05 and found.difference.value < -0.5 and found.difference.high < 0.0
    assert summary.differences["fleet", "pd_friction", "upright"].p > 0.05
    assert [row[0] for row in headline_table(summary).rows] == ["ideal_pd", "pd_friction", "pd_adapted", "prior"]
    assert [row[0] for row in difference_table(summary).rows] == ["ideal_pd", "pd_friction", "pd_adapted"]
