"""A table of walks is independent of the order of its rows and survives saving."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.commands.transfer_study.walk_table import OWN, WalkRow, WalkTable
from motorprior.exceptions import ArtifactError


def row(place: str, condition: str, seed: int, draw: int, speed: float, slip: float = 0.1) -> WalkRow:
    return WalkRow(place, condition, seed, draw, {"speed": speed, "slip": slip})


def test_scores_are_sorted_by_seed_and_draw():
    walks = [row("fleet", "prior", seed, draw, 10 * seed + draw) for seed in (7, 3) for draw in (2, 0, 1)]
    scores = WalkTable.of([*walks, row(OWN, "prior", 3, 0, 99.0), row("fleet", "pd", 3, 0, 98.0)]).scores
    np.testing.assert_array_equal(scores("fleet", "prior", "speed"), [[30, 31, 32], [70, 71, 72]])
    assert np.isnan(scores("fleet", "prior", "no such measure")).all()
    assert scores("hard", "prior", "speed").shape == (0, 0)


def test_names_keep_the_order_of_the_rows_and_numbers_do_not():
    table = WalkTable.of([row("hard", "z", 2, 1, 0.0), row("fleet", "a", 1, 0, 0.0)])
    found = [table.distinct(key) for key in ("place", "condition", "seed", "draw")]
    assert found == [["hard", "fleet"], ["z", "a"], [1, 2], [0, 1]]


@pytest.mark.parametrize("missing", [0, 3])
def test_a_missing_walk_is_an_error(missing: int):
    walks = [row("fleet", "prior", seed, draw, 0.0) for seed in (0, 1) for draw in (0, 1)]
    del walks[missing]
    with pytest.raises(ArtifactError, match=r"prior in fleet: 3 walks.*2 seeds and 2 draws"):
        WalkTable.of(walks).scores("fleet", "prior", "speed")


def test_a_saved_table_is_read_back_with_undefined_measures(tmp_path: Path):
    measures = {"speed": 0.123456, "torque": float("nan")}
    names = ("plain", 'with, comma and "quotes"', "of two\nlines")
    table = WalkTable.of(WalkRow("own", name, 3, draw, measures) for name in names for draw in range(2))
    table.save(tmp_path / "walks.csv")
    found = WalkTable.load(tmp_path / "walks.csv")
    assert [(w.place, w.condition, w.seed, w.draw) for w in found.walks] == [
        (w.place, w.condition, w.seed, w.draw) for w in table.walks
    ]
    assert all(walk.measures["speed"] == 0.123456 and np.isnan(walk.measures["torque"]) for walk in found.walks)
    before = (tmp_path / "walks.csv").read_bytes()
    found.save(tmp_path / "walks.csv")
    assert (tmp_path / "walks.csv").read_bytes() == before


def test_a_measure_that_only_some_walks_have_is_unknown_of_the_others(tmp_path: Path):
    WalkTable.of([row("a", "b", 0, 0, 1.0), WalkRow("a", "b", 0, 1, {"lift": 2.0})]).save(tmp_path / "walks.csv")
    found = WalkTable.load(tmp_path / "walks.csv").scores("a", "b", "lift")
    np.testing.assert_array_equal(found, [[np.nan, 2.0]])
