"""A minimal transfer study has every condition in every environment and resumes exactly."""

import shutil
from collections import defaultdict
from dataclasses import replace
from functools import partial
from itertools import product
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
from motorprior.studies.statistics import (
    IN_TRAINING,
    IN_TRAINING_OUT_OF_FAMILY,
    SAMPLED_PRIOR,
    read_walks,
    scores,
)
from motorprior.studies.study_settings import CONDITIONS, PDS, SHORT_ITERATIONS, Study
from motorprior.studies.transfer import CHOICES, WALKS, policy_runs_of
from motorprior.studies.transfer_models import FIT

NUM_WALKS = 2


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
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
def test_every_policy_walks_on_every_sample_of_its_environments(study: Study):
    walks = read_walks(study.out / WALKS)
    conditions = defaultdict(list)

    for walk in walks:
        conditions[walk["environment"], walk["condition"]].append(walk)

    for environment, condition in product((IN_TRAINING, *ENVIRONMENTS), study.conditions):
        speeds = scores(conditions[environment, condition], "speed")
        assert speeds.shape == (study.benches, study.seeds, NUM_WALKS)

    out_of_family = {
        walk["condition"] for walk in walks if walk["environment"] == IN_TRAINING_OUT_OF_FAMILY
    }

    assert out_of_family == {"oracle", "adapted_prior", "adapted_motors", "adapted_pd"}


@pytest.mark.slow
def test_policies_walk_at_the_command_of_their_training(study: Study):
    folder = study.out / "bench_0" / "policies" / "oracle_0"
    trained = TrainedPolicy.load(folder / POLICY, load_robot(study.robot))
    low, high = trained.policy.provenance["commands"]["forward"]

    assert low == high == pytest.approx(0.75)

    walk = WalkConfig(250, randomization=trained.randomization, commands=Commands.steady(low))
    seed_of = partial(walk_seed, 0)
    episodes = run_walks(trained.scene(walk), trained.policy.arrays, range(NUM_WALKS), seed_of)

    speeds = []
    for row in read_walks(study.out / WALKS):
        if (row["bench"], row["environment"], row["condition"]) == (0, IN_TRAINING, "oracle"):
            speeds.append(row["speed"])

    expected = [episode.displacement[0] / 2.5 for episode in episodes]  # walks of 2.5 s

    assert speeds == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_figures_have_intervals_and_p_values(study: Study):
    figures = read_json(study.out / "figures.json")
    for environment, condition in product(ENVIRONMENTS, study.conditions):
        upright = f"{environment}/{condition}/upright"
        assert figures[f"{upright}/low"] <= figures[upright] <= figures[f"{upright}/high"]
        if condition != SAMPLED_PRIOR:
            p = figures[f"{environment}/{condition}/speed_p_against_{SAMPLED_PRIOR}"]
            assert 0.0 < p <= 1.0


@pytest.mark.slow
def test_fits_selections_and_the_page_of_a_study_are_written(study: Study):
    fits = {name: read_json(study.out / "bench_0" / "fits" / name / FIT) for name in PDS}

    assert fits["gains"]["error"] >= fits["rotor"]["error"] >= 0.9 * fits["friction"]["error"]

    for setting, choices in CHOICES.items():
        selection = read_json(study.out / "selection" / f"{setting}.json")
        assert selection["fleet"] == "mixed"
        assert selection["chosen"] in choices

    page = (study.out / "report.html").read_text("utf-8")

    assert "adapted_prior" in page
    assert "out_of_family" in page


@pytest.mark.slow
def test_an_interrupted_study_resumes_to_the_same_bytes(study: Study):
    original = (study.out / WALKS).read_bytes()
    shutil.rmtree(study.out / "bench_0" / "walks" / "sampled_prior_0")
    (study.out / "bench_1" / "policies" / "sampled_prior_0" / "stage.json").unlink()
    run_study(study)

    assert (study.out / WALKS).read_bytes() == original


def test_a_short_training_has_fewer_iterations_and_the_sampled_priors_motors(tmp_path: Path):
    study = Study(tmp_path, conditions=("sampled_prior", "short_training"), iterations=120)

    full, short = policy_runs_of(study, 0)

    assert full.bench.iterations == 120
    assert short.bench.iterations == 70
    assert full.motors == short.motors


def test_a_short_condition_has_one_policy_of_few_iterations(tmp_path: Path):
    study = Study(tmp_path, conditions=("sampled_prior", "oracle"), short=("sampled_prior",))

    assert len(study.seeds_of("sampled_prior")) == 1
    assert len(study.seeds_of("oracle")) == study.seeds
    run = policy_runs_of(replace(study, environments=("fleet",)), 0)[0]
    assert run.name == "sampled_prior"
    assert run.bench.iterations == SHORT_ITERATIONS


def test_an_adapted_condition_is_trained_for_the_populations_of_its_environments(tmp_path: Path):
    study = Study(tmp_path, conditions=("oracle",))

    both = policy_runs_of(study, 0)
    in_family = policy_runs_of(replace(study, environments=("fleet", "hard")), 0)

    assert {run.population for run in both} == {"fleet", "out_of_family"}
    assert [run.population for run in in_family] == ["fleet"]


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
def test_an_invalid_setting_is_refused_by_its_name(tmp_path: Path, change: dict, argument: str):
    with pytest.raises(MotorPriorError) as error:
        Study(tmp_path, **change).require_valid()
    assert error.value.argument == argument
