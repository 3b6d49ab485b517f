"""Several seeds of one training: each is the training of that seed alone, whatever was interrupted."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking import walk_seeds
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.pipeline.walking.walk_metrics import METRICS, read_metrics
from motorprior.pipeline.walking.walk_seeds import PICTURE, run_walk_seeds
from motorprior.report.plots_seeds import seed_curves
from motorprior.search.ars import ArsConfig


def small(folder: Path, seed: int = 3) -> Walk:
    search = ArsConfig(seed=seed, num_directions=2, num_top_directions=2)
    return Walk(folder, MotorChoice("pd"), iterations=2, episode_steps=10, search=search)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeds")
    results = run_walk_seeds(small(folder), 3)
    assert results.distinct("seed") == [3, 4, 5]
    return folder


def test_every_seed_is_the_training_of_that_seed(seeds: Path, tmp_path: Path):
    run_walk(small(tmp_path, seed=4))
    for name in (POLICY, METRICS):
        assert (seeds / "seed_4" / name).read_bytes() == (tmp_path / name).read_bytes()
    policies = {(seeds / f"seed_{seed}" / POLICY).read_bytes() for seed in (3, 4, 5)}
    assert len(policies) == 3 and (seeds / PICTURE).is_file() and (seeds / "figures.json").is_file()


def test_seeds_that_end_early_are_drawn_with_those_that_do_not(tmp_path: Path):
    search = ArsConfig(seed=0, num_directions=2, num_top_directions=2)
    walk = Walk(tmp_path, MotorChoice("pd"), iterations=40, patience=1, episode_steps=10, search=search)
    run_walk_seeds(walk, 3)
    ended = [len(read_metrics(tmp_path / f"seed_{seed}")["iteration"]) for seed in range(3)]
    assert min(ended) < 40 and all(each % 10 == 0 for each in ended) and (tmp_path / PICTURE).is_file()


def test_what_is_finished_is_not_trained_again(seeds: Path, monkeypatch: pytest.MonkeyPatch):
    picture = (seeds / PICTURE).read_bytes()
    before = {path: path.stat().st_mtime_ns for path in seeds.glob(f"*/{POLICY}")}
    (seeds / PICTURE).unlink()
    run_walk_seeds(small(seeds), 3)
    assert before == {path: path.stat().st_mtime_ns for path in seeds.glob(f"*/{POLICY}")}
    assert (seeds / PICTURE).read_bytes() == picture


def test_a_seed_that_is_refused_ends_all_before_another_is_touched(tmp_path: Path):
    """The policy of the second seed is the start: what the first one has would be gone when that is found out."""
    run_walk_seeds(small(tmp_path), 2)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    further = replace(small(tmp_path), start=tmp_path / "seed_4" / POLICY)
    with pytest.raises(ConfigError, match="which the training would overwrite"):
        run_walk_seeds(replace(further, workers=1), 2)
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


def test_a_failing_seed_ends_all_with_its_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def train(walk: Walk, *_: Any) -> None:
        if walk.search.seed == 4:
            raise ArtifactError("no room")

    monkeypatch.setattr(walk_seeds, "run_walk", train)
    with pytest.raises(ArtifactError, match="no room"):
        run_walk_seeds(small(tmp_path), 3)
    assert not (tmp_path / PICTURE).exists()


def test_the_median_is_of_the_seeds_at_every_iteration():
    values = np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 9.0], [0.0, 5.0, 4.0]])
    returned, upright = seed_curves(np.arange(3), {"mean return [m]": values, "time upright [-]": values / 10.0}).axes
    np.testing.assert_array_equal(np.asarray(returned.lines[0].get_ydata()), [1.0, 2.0, 4.0])
    assert (returned.get_ylabel(), upright.get_xlabel()) == ("mean return [m]", "iteration [-]")
    assert returned.get_title(loc="left") == "Learning to walk, 3 seeds"


@pytest.mark.parametrize("text", ["", "{}\n", "no json\n", '{"iteration": 0}\n', "[1]\n"])
def test_metrics_that_are_none_are_refused(tmp_path: Path, text: str):
    (tmp_path / METRICS).write_text(text)
    if text:
        with pytest.raises(ArtifactError, match="metrics"):
            read_metrics(tmp_path)
    else:
        assert all(len(values) == 0 for values in read_metrics(tmp_path).values())


def test_no_seeds_are_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match="seeds 0"):
        run_walk_seeds(small(tmp_path), 0)
