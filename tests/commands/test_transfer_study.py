"""A minimal transfer study: every condition in every environment, resumable to the same bytes."""

import shutil
from functools import partial
from pathlib import Path

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.transfer import run_study
from motorprior.exceptions import MotorPriorError
from motorprior.locomotion.command import Commands
from motorprior.robots.load import load_robot
from motorprior.simulation.scene import WalkConfig
from motorprior.simulation.training import POLICY
from motorprior.studies.compare import TrainedPolicy, run_walks
from motorprior.studies.environments import ENVIRONMENTS, walk_seed
from motorprior.studies.statistics import OWN, OWN_OUT_OF_FAMILY, REFERENCE, read_walks, scores
from motorprior.studies.study_settings import CONDITIONS, PDS, Study
from motorprior.studies.transfer import CHOICES, WALKS, policy_runs_of
from motorprior.studies.transfer_models import FIT

NUM_WALKS = 2


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Study:
    pytest.importorskip("pybullet")
    config = Study(
        tmp_path_factory.mktemp("study") / "run",
        benches=2,
        seeds=1,
        walks=NUM_WALKS,
        seconds=2.5,
        iterations=1,
        conditions=tuple(CONDITIONS),
        motors=12,
        bench_steps=1500,
        adam_steps=30,
        workers=2,
    )
    run_study(config)
    return config


@pytest.mark.slow
def test_every_policy_walks_every_draw_in_its_environments(done: Study):
    walks = read_walks(done.out / WALKS)
    for environment in (OWN, *ENVIRONMENTS):
        for condition in done.conditions:
            cell = [
                walk
                for walk in walks
                if (walk["environment"], walk["condition"]) == (environment, condition)
            ]
            assert scores(cell, "speed").shape == (done.benches, done.seeds, NUM_WALKS)
    own_out_of_family = {
        walk["condition"] for walk in walks if walk["environment"] == OWN_OUT_OF_FAMILY
    }
    assert own_out_of_family == {"oracle", "adapted_prior", "adapted_pd"}


@pytest.mark.slow
def test_walks_have_the_command_of_the_training(done: Study):
    folder = done.out / "bench_0" / "policies" / "oracle_0"
    trained = TrainedPolicy.load(folder / POLICY, load_robot(done.robot))
    low, high = trained.policy.provenance["commands"]["forward"]
    assert low == high == pytest.approx(0.75)
    walk = WalkConfig(250, randomization=trained.randomization, commands=Commands.steady(low))
    seed_of = partial(walk_seed, 0)
    episodes = run_walks(trained.scene(walk), trained.policy.arrays, range(NUM_WALKS), seed_of)
    rows = [
        walk
        for walk in read_walks(done.out / WALKS)
        if (walk["bench"], walk["environment"]) == (0, OWN)
    ]
    found = [walk["speed"] for walk in rows if walk["condition"] == "oracle"]
    assert found == pytest.approx([episode.displacement[0] / 2.5 for episode in episodes], rel=1e-4)


@pytest.mark.slow
def test_figures_have_intervals_and_p_values(done: Study):
    figures = read_json(done.out / "figures.json")
    for twin in ENVIRONMENTS:
        for condition in done.conditions:
            low, value, high = (
                figures[f"{twin}/{condition}/upright{end}"] for end in ("/low", "", "/high")
            )
            assert low <= value <= high
            if condition != REFERENCE:
                assert 0.0 < figures[f"{twin}/{condition}/speed_p_against_{REFERENCE}"] <= 1.0
    fits = {kind: read_json(done.out / "bench_0" / "fits" / kind / FIT) for kind in PDS}
    assert fits["gains"]["error"] >= fits["rotor"]["error"] >= 0.9 * fits["friction"]["error"]
    for setting, choices in CHOICES.items():
        selection = read_json(done.out / "selection" / f"{setting}.json")
        assert selection["fleet"] == "mixed" and selection["chosen"] in choices
    page = (done.out / "report.html").read_text("utf-8")
    assert "adapted_prior" in page and "out_of_family" in page


@pytest.mark.slow
def test_an_interrupted_study_resumes_to_the_same_bytes(done: Study):
    before = (done.out / WALKS).read_bytes()
    shutil.rmtree(done.out / "bench_0" / "walks" / "sampled_prior_0")
    (done.out / "bench_1" / "policies" / "sampled_prior_0" / "stage.json").unlink()
    run_study(done)
    assert (done.out / WALKS).read_bytes() == before


def test_a_short_training_has_fewer_iterations_and_the_sampled_priors_motors(tmp_path: Path):
    bench = Study(tmp_path, conditions=("sampled_prior", "short_training"), iterations=120)
    one, short = policy_runs_of(bench, 0)
    assert (one.bench.iterations, short.bench.iterations) == (
        120,
        40,
    ) and one.motors == short.motors


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"out_of_family": "pupper_v2"}, "out_of_family"),
        ({"conditions": ("nothing",)}, "conditions"),
        ({"motors": 4}, "motors"),
        ({"patience": 0}, "patience"),
        ({"pd_range": 1.5}, "pd_range"),
        ({"prior_share": -1.0}, "prior_share"),
        ({"seconds": 0.0}, "seconds"),
        ({"validation": "nothing"}, "validation"),
    ],
)
def test_invalid_settings_are_an_error(tmp_path: Path, change: dict, argument: str):
    with pytest.raises(MotorPriorError) as error:
        Study(tmp_path, **change).require_valid()
    assert error.value.argument == argument
