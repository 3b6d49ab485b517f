"""A training in a folder: one seed or several, resumed, validated on another fleet; its page."""

import json
from contextlib import contextmanager
from dataclasses import replace
from html import unescape
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from motorprior import stage
from motorprior.artifacts import read_json
from motorprior.commands.walk import PICTURE, Walk, run_walk, run_walk_seeds
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.policy_search import (
    EVALUATION,
    EVALUATION_EPISODES,
    PolicySearch,
    episode_seed,
)
from motorprior.progress import Progress, Task
from motorprior.report.sections import write_training_page
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.scene import Scene, WalkSimulator
from motorprior.simulation.training import CHECKPOINT, CURVE, METRICS, POLICY
from motorprior.stage import MARKER


def walk(folder: Path, seed: int = 2, **changes) -> Walk:
    search = ArsConfig(seed=seed, num_directions=2, num_top_directions=2)
    settings = {
        "motors": "pd:kp=8",
        "iterations": 3,
        "episode_steps": 10,
        "workers": 1,
        "search": search,
    } | changes
    return Walk(out=folder, **settings)


def test_a_training_does_not_overwrite_the_policy_that_it_starts_from(tmp_path: Path):
    run_walk(walk(tmp_path))
    original = (tmp_path / POLICY).read_bytes()
    again = walk(tmp_path / "x" / "..", start=tmp_path / POLICY, iterations=1)

    with pytest.raises(ConfigError, match="overwrite"):
        run_walk(again)
    assert (tmp_path / POLICY).read_bytes() == original
    assert (tmp_path / MARKER).is_file()
    assert run_walk(replace(again, out=tmp_path / "further"))


def test_a_start_policy_is_kept_without_improvement_and_refused_if_its_shape_differs(
    tmp_path: Path,
):
    run_walk(walk(tmp_path / "first", episode_steps=20))
    start = tmp_path / "first" / POLICY
    wild = ArsConfig(seed=2, num_directions=2, num_top_directions=2, step_size=100.0)
    run_walk(walk(tmp_path / "second", episode_steps=20, iterations=1, start=start, search=wild))
    first, second = (Policy.load(tmp_path / name / POLICY) for name in ("first", "second"))

    np.testing.assert_array_equal(second.arrays.weights, first.arrays.weights)
    assert second.provenance["start_sha256"]
    assert first.provenance["start_sha256"] is None

    with pytest.raises(ConfigError):
        run_walk(walk(tmp_path / "other", start=start, hidden_units=4))


def test_every_seed_of_several_equals_the_training_of_that_seed_and_is_not_repeated(tmp_path: Path):
    config = walk(tmp_path / "seeds", seed=3, workers=2, seeds=3)
    results = run_walk_seeds(config)

    assert results.distinct("seed") == [3, 4, 5]

    run_walk(walk(tmp_path / "one", seed=4))

    for name in (POLICY, METRICS):
        alone = (tmp_path / "one" / name).read_bytes()
        assert (tmp_path / "seeds" / "seed_4" / name).read_bytes() == alone

    written = {path: path.stat().st_mtime_ns for path in config.out.glob(f"*/{POLICY}")}

    assert len({path.read_bytes() for path in written}) == 3
    assert (config.out / PICTURE).is_file()
    assert run_walk_seeds(config) == results
    assert {path: path.stat().st_mtime_ns for path in written} == written


def test_the_best_return_of_a_policy_is_its_mean_return_on_the_validation_fleet(tmp_path: Path):
    config = walk(tmp_path, validation="mixed", episode_steps=30)
    run_walk(config)
    policy = Policy.load(tmp_path / POLICY)
    robot = PUPPER_V2.with_speed_range(policy.forward)
    motors = simulated_motors("fleet:mixed", robot)
    simulator = WalkSimulator(Scene(robot, motors.draw, config, motors.physics_dt))
    seeds = [
        episode_seed(config.search.seed, EVALUATION, draw) for draw in range(EVALUATION_EPISODES)
    ]

    returns = [simulator.run(policy.arrays, seed).total for seed in seeds]

    assert policy.provenance["best_return"] == np.mean(returns)
    assert policy.provenance["validation"] == "mixed"


def test_a_training_that_ends_early_is_the_same_with_threads_and_after_interrupts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    early = {"validation": "mixed", "patience": 1, "iterations": 40, "episode_steps": 30}
    run_walk(walk(tmp_path / "whole", **early))
    num_evaluations = len(read_json(tmp_path / "whole" / CURVE))

    class Stops(Progress):
        """Interrupts the training after this number of noted advances."""

        def __init__(self, after: int):
            super().__init__(lambda text: None)
            self.left = after

        @contextmanager
        def start(self, name: str, total: int):
            yield Mock(spec=Task, advance=self.advance)

        def advance(self, count: int = 1, note: str = "") -> None:
            self.left -= bool(note)
            if self.left == 0:
                raise KeyboardInterrupt

    folder = tmp_path / "interrupted"
    interrupted = walk(folder, **early, workers=2)

    # at the second interrupt all iterations are made, and nothing is written yet
    for after in (num_evaluations - 1, 1):
        with pytest.raises(KeyboardInterrupt):
            run_walk(interrupted, Stops(after))
    with monkeypatch.context() as patch, pytest.raises(SystemExit):  # all is written but the marker
        patch.setattr(stage, "write_json", Mock(side_effect=SystemExit(137)))
        run_walk(interrupted, Stops(99))

    monkeypatch.setattr(PolicySearch, "advance", None)  # no iteration is repeated

    assert not (folder / MARKER).exists()
    assert (folder / CHECKPOINT).exists()

    run_walk(interrupted, Stops(99))

    assert (folder / MARKER).is_file()
    assert not (folder / CHECKPOINT).exists()
    for name in (POLICY, CURVE, METRICS):
        assert (folder / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()

    lines = (folder / METRICS).read_text("utf-8").splitlines()

    assert [json.loads(line) for line in lines] == read_json(folder / CURVE)


def test_the_page_shows_every_training_once_by_the_name_of_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("MUJOCO_GL", "disable")

    with pytest.raises(ConfigError, match=r"policy\.safetensors"):
        write_training_page(tmp_path, "pupper_v2", "motorprior report")

    for name, seed in (("slow_0", 0), ("slow_1", 1), ("quick", 0)):
        run_walk(walk(tmp_path / name, seed, iterations=1, episode_steps=5))

    page = unescape(
        write_training_page(tmp_path, "pupper_v2", "motorprior report").read_text("utf-8")
    )

    assert page.count("data:image/gif") == 2
    assert all(f"Trained on {name}" in page for name in ("slow", "quick"))
