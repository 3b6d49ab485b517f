"""A minimal transfer study: every condition in every environment, resumable to the same bytes."""

import shutil
from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.study import WALKS, run_study
from motorprior.commands.study_conditions import FIXED_MOTORS, Study
from motorprior.exceptions import MotorPriorError
from motorprior.studies.environments import ENVIRONMENTS
from motorprior.studies.summary import CONDITIONS, OWN, OWN_FOREIGN, read_walks, scores

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
    walks = read_walks(done.out / WALKS)
    for place in (OWN, *ENVIRONMENTS):
        for condition in CONDITIONS:
            cell = [walk for walk in walks if (walk["place"], walk["condition"]) == (place, condition)]
            if condition == "untrained":
                assert len(cell) == (0 if place == OWN else DRAWS)
                continue
            draws = 1 if place == OWN and condition in FIXED_MOTORS else DRAWS
            assert scores(cell, "speed").shape == (done.seeds, draws)
    own_foreign = {walk["condition"] for walk in walks if walk["place"] == OWN_FOREIGN}
    assert own_foreign == {"oracle", "prior_adapted", "pd_adapted"}


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
        Study(tmp_path, **change).require_valid()
    assert error.value.argument == argument
