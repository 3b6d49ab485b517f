"""The transfer study, as small as it gets: every condition at every place, resumed to the same bytes."""

import shutil
from dataclasses import replace

import pytest

from motorprior.artifacts import read_json
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import SILENT
from motorprior.pipeline.transfer_study.condition import Condition
from motorprior.pipeline.transfer_study.study import run_study
from motorprior.pipeline.transfer_study.study_cells import walk_table
from motorprior.pipeline.transfer_study.study_report import TRACES, WALKS, build_study_report
from motorprior.pipeline.transfer_study.study_settings import Study
from motorprior.transfer.places import TWINS
from motorprior.transfer.walk_table import OWN, OWN_ABROAD, WalkTable

pytestmark = pytest.mark.slow
EVERYWHERE = {
    "ideal_pd", "tuned_pd", "pd_friction", "pd_randomised", "one_network", "paper", "paper_wide", "prior_mean", "prior",
    "prior_adapted", "prior_robust", "oracle", "pd_adapted",
}  # fmt: skip
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


def test_every_policy_walks_every_draw_where_it_belongs(done: Study):
    table = WalkTable.load(done.out / WALKS)
    for place in (OWN, *TWINS):
        gait = set() if place == OWN else {"untrained"}
        assert set(table.at(place).distinct("condition")) == EVERYWHERE | gait
        assert all(table.scores(place, name, "speed").shape == (1, DRAWS) for name in gait)
        for condition in EVERYWHERE:
            draws = 1 if place == OWN and condition in FIXED else DRAWS
            assert table.scores(place, condition, "speed").shape == (done.seeds, draws)
    assert set(table.at(OWN_ABROAD).distinct("condition")) == {"oracle", "prior_adapted", "pd_adapted"}


def test_figures_have_intervals(done: Study):
    figures = read_json(done.out / "figures.json")
    for twin in TWINS:
        for condition in EVERYWHERE:
            for measure in ("speed", "upright"):
                low, value, high = (figures[f"{twin}/{condition}/{measure}{end}"] for end in ("/low", "", "/high"))
                assert low <= value <= high
                assert condition == "prior" or 0.0 < figures[f"{twin}/{condition}/{measure}_p_against_prior"] <= 1.0
    assert "fleet/prior/ratio" in figures and "fleet/prior/regret" in figures
    assert "own_foreign/oracle/speed" in figures
    assert not [name for name in figures if "drift_p" in name]


def test_fits_say_what_they_took(done: Study):
    fits = read_json(done.out / "fits" / "fits.json")
    assert set(fits) == {"ideal_pd", "tuned_pd", "pd_friction"}
    assert fits["ideal_pd"]["error"] >= fits["tuned_pd"]["error"] >= 0.9 * fits["pd_friction"]["error"]
    assert all(fit["evaluations"] > 50 and fit["converged"] for fit in fits.values())


def test_the_rival_has_the_spread_whose_policies_stand_longest(done: Study):
    told = read_json(done.out / "spreads" / "spreads.json")
    found, chosen = told["tried"], told["chosen"]
    assert (told["fleet"], set(found)) == ("mixed", {"0.1", "0.2", "0.3", "0.4"})
    assert found[f"{chosen:g}"] == max(found.values(), key=lambda walked: (walked["upright"], walked["speed"]))
    settings = read_json(done.out / "study.json")
    assert (settings["spread"], settings["validation"]) == (str(chosen), "mixed")
    header = Policy.load(done.out / "walk" / "pd_randomised_0" / "policy.safetensors").provenance
    assert header["motors"]["spread"] == chosen


def test_motors_of_the_prior_are_drawn_as_wide_as_they_differ(done: Study):
    assert read_json(done.out / "study.json")["latent_spread"] == "1.0"
    for name, width in (("prior", 1.0), ("prior_robust", 1.0), ("prior_mean", 0.0)):
        header = Policy.load(done.out / "walk" / f"{name}_0" / "policy.safetensors").provenance
        assert header["motors"]["latent_spread"] == width


def test_what_was_interrupted_goes_on_to_the_same_bytes(done: Study):
    """A walk, a measured policy and the table are gone; other workers go on."""
    kept = {name: (done.out / name).read_bytes() for name in (WALKS, TRACES, "figures.json")}
    shutil.rmtree(done.out / "watched" / "prior_1")
    shutil.rmtree(done.out / "walk" / "paper_0")
    shutil.rmtree(done.out / "watched" / "paper_0")
    (done.out / WALKS).unlink()
    run_study(replace(done, workers=1), SILENT)
    assert {name: (done.out / name).read_bytes() for name in kept} == kept


def test_ray_walks_to_the_same_bytes(done: Study):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'motorprior[ray]'")
    kept = {name: (done.out / name).read_bytes() for name in (WALKS, TRACES, "figures.json")}
    for gone in ("walk/prior_adapted_foreign_0", "watched/prior_adapted_foreign_0", "watched/oracle_1"):
        shutil.rmtree(done.out / gone)
    run_study(replace(done, executor="ray"), SILENT)
    assert {name: (done.out / name).read_bytes() for name in kept} == kept


def test_ray_walks_contests_of_a_validation_fleet_too(done: Study):
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'motorprior[ray]'")
    for kind in ("threads", "ray"):
        study = replace(done, executor=kind, draws=1, out=done.out.parent / kind)
        pd = Condition("pd", MotorChoice("pd", name="pd"), twins=("fleet",))
        walk_table(study.sized(), [(pd, 0)]).save(done.out.parent / f"{kind}.csv")
    assert (done.out.parent / "ray.csv").read_bytes() == (done.out.parent / "threads.csv").read_bytes()
    files = [done.out.parent / kind / "walk" / "pd_0" / "policy.safetensors" for kind in ("threads", "ray")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_it_has_a_page(done: Study):
    page = build_study_report(done.out, "motorprior transfer --study").read_text("utf-8")
    assert "targets" in page and "PD with friction" in page
