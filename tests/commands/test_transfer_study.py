"""A minimal transfer study: every condition in every environment, resumable to the same bytes."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from motorprior.artifacts import read_json
from motorprior.commands.transfer_study.settings import CONDITIONS, Study
from motorprior.commands.transfer_study.study import difference_table, headline_table, run_study, summarise
from motorprior.commands.transfer_study.walk_table import OWN, OWN_FOREIGN, WalkRow, WalkTable
from motorprior.commands.transfer_study.walks import WALKS
from motorprior.exceptions import MotorPriorError
from motorprior.studies.environments import ENVIRONMENTS

FIXED = {"ideal_pd", "tuned_pd", "pd_friction", "pd_adapted", "prior_mean", "one_network"}
DRAWS = 2


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Study:
    pytest.importorskip("pybullet")
    config = Study(
        tmp_path_factory.mktemp("study") / "run", seeds=2, draws=DRAWS, seconds=2.5, iterations=1, motors=12,
        bench_steps=1500, adam_steps=30, workers=2,
    )  # fmt: skip
    run_study(config)
    return config


@pytest.mark.slow
def test_every_policy_walks_every_draw_in_its_environments(done: Study):
    table = WalkTable.load(done.out / WALKS)
    for place in (OWN, *ENVIRONMENTS):
        for condition in CONDITIONS:
            if condition == "untrained":
                assert len(table.at(place, condition)) == (0 if place == OWN else DRAWS)
                continue
            draws = 1 if place == OWN and condition in FIXED else DRAWS
            assert table.scores(place, condition, "speed").shape == (done.seeds, draws)
    assert set(table.at(OWN_FOREIGN).distinct("condition")) == {"oracle", "prior_adapted", "pd_adapted"}


@pytest.mark.slow
def test_figures_have_intervals_and_p_values(done: Study):
    figures = read_json(done.out / "figures.json")
    for twin in ENVIRONMENTS:
        for condition in CONDITIONS:
            low, value, high = (figures[f"{twin}/{condition}/upright{end}"] for end in ("/low", "", "/high"))
            assert low <= value <= high
            if condition not in ("prior", "untrained"):
                assert 0.0 < figures[f"{twin}/{condition}/speed_p_against_prior"] <= 1.0
    fits = read_json(done.out / "fits" / "fits.json")
    assert fits["ideal_pd"]["error"] >= fits["tuned_pd"]["error"] >= 0.9 * fits["pd_friction"]["error"]
    assert read_json(done.out / "spreads" / "spreads.json")["fleet"] == "mixed"
    page = (done.out / "report.html").read_text("utf-8")
    assert "prior_adapted" in page and "foreign" in page


@pytest.mark.slow
def test_an_interrupted_study_resumes_to_the_same_bytes(done: Study):
    before = (done.out / WALKS).read_bytes()
    shutil.rmtree(done.out / "watched" / "prior_0")
    (done.out / "walk" / "prior_1" / "stage.json").unlink()
    run_study(done)
    assert (done.out / WALKS).read_bytes() == before


def invented(conditions: dict[str, float], seeds: int = 8, draws: int = 16) -> WalkTable:
    """Walks on one environment, upright for a share about that of the condition."""
    rng = np.random.default_rng(0)
    return WalkTable.of(
        WalkRow(
            "fleet", name, seed, draw, {"speed": upright, "upright": float(np.clip(rng.normal(upright, 0.02), 0, 1))}
        )
        for name, upright in conditions.items()
        for seed in range(seeds)
        for draw in range(draws)
    )


def test_a_clear_difference_is_significant_and_none_is_not():
    summary = summarise(invented({"prior": 0.9, "ideal_pd": 0.3, "pd_friction": 0.9}))
    key = ("fleet", "ideal_pd", "upright")
    difference = summary.differences[key].difference
    assert summary.p[key] < 0.05 and difference.value < -0.5 and difference.high < 0.0
    key = ("fleet", "pd_friction", "upright")
    assert summary.p[key] > 0.05
    assert [row[0] for row in headline_table(summary).rows] == ["ideal_pd", "pd_friction", "prior"]
    assert [row[0] for row in difference_table(summary).rows] == ["ideal_pd", "pd_friction"]


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"foreign": "pupper_v2"}, "foreign"),
        ({"conditions": ("nothing",)}, "conditions"),
        ({"motors": 4}, "motors"),
        ({"validation": "nothing"}, "validation"),
    ],
)
def test_invalid_settings_are_an_error(tmp_path: Path, change: dict, argument: str):
    with pytest.raises(MotorPriorError) as error:
        Study(tmp_path, **change).sized()
    assert error.value.argument == argument
