"""Several seeds of one training: each is the training of that seed alone, whatever was interrupted."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.pipeline.walking.walk_metrics import METRICS
from motorprior.pipeline.walking.walk_seeds import PICTURE, run_walk_seeds
from motorprior.report.plots_walk import seed_curves
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


def test_what_is_finished_is_not_trained_again(seeds: Path, monkeypatch: pytest.MonkeyPatch):
    picture = (seeds / PICTURE).read_bytes()
    before = {path: path.stat().st_mtime_ns for path in seeds.glob(f"*/{POLICY}")}
    (seeds / PICTURE).unlink()
    run_walk_seeds(small(seeds), 3)
    assert before == {path: path.stat().st_mtime_ns for path in seeds.glob(f"*/{POLICY}")}
    assert (seeds / PICTURE).read_bytes() == picture


def test_the_median_is_of_the_seeds_at_every_iteration():
    values = np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 9.0], [0.0, 5.0, 4.0]])
    returned, upright = seed_curves(np.arange(3), {"mean return [m]": values, "time upright [-]": values / 10.0}).axes
    np.testing.assert_array_equal(np.asarray(returned.lines[0].get_ydata()), [1.0, 2.0, 4.0])
    assert (returned.get_ylabel(), upright.get_xlabel()) == ("mean return [m]", "iteration [-]")
    assert returned.get_title(loc="left") == "Learning to walk, 3 seeds"
