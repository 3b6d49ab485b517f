"""A training whose policies are evaluated on another fleet's motors."""

from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.artifacts import read_json
from motorprior.commands.walk import POLICY, Walk, run_walk
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.policy_search import EVALUATION, EVALUATION_DRAWS, episode_seed
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.scene import Scene, WalkSimulator


def walk(folder: Path, **changes) -> Walk:
    search = ArsConfig(seed=2, num_directions=2, num_top_directions=2)
    return Walk(out=folder, motors="pd", iterations=3, episode_steps=30, search=search, **changes)


def test_the_policy_that_is_kept_has_the_score_that_it_has_on_the_validation_fleet(tmp_path: Path):
    config = walk(tmp_path, validation="mixed")
    run_walk(config)
    policy = Policy.load(tmp_path / POLICY)
    robot = PUPPER_V2.with_speed_range(policy.forward)
    found = simulated_motors("fleet:mixed", robot)
    there = WalkSimulator(Scene(robot, found.draw, config, found.physics_dt))
    seeds = [episode_seed(config.search.seed, EVALUATION, draw) for draw in range(EVALUATION_DRAWS)]
    score = np.mean([there.run(policy.arrays, seed).total for seed in seeds])
    assert policy.provenance["own_return"] == score
    assert policy.provenance["validation"] == "mixed"


def test_threads_and_interrupts_change_nothing(tmp_path: Path):
    long = {"validation": "mixed", "patience": 1}
    run_walk(replace(walk(tmp_path / "whole", **long), iterations=40))
    ended = len(read_json(tmp_path / "whole" / "curve.json"))
    assert ended % 10 == 0

    class Stops:
        def __init__(self, after: int):
            self.left = after

        @contextmanager
        def start(self, name: str, total: int):
            yield self

        def advance(self, count: int = 1, note: str = "") -> None:
            self.left -= bool(note)
            if self.left == 0:
                raise KeyboardInterrupt

        def note(self, text: str) -> None:
            resumed = [f"walk: continues after iteration {number}" for number in (ended - 1, ended)]
            assert f"ended after {ended} iterations" in text or text in resumed

    parts = replace(walk(tmp_path / "parts", **long), iterations=40, workers=2)
    for after in (ended - 1, 1):  # the second: all iterations are made, and nothing is written yet
        with pytest.raises(KeyboardInterrupt):
            run_walk(parts, Stops(after))
    run_walk(parts, Stops(99))
    for name in (POLICY, "curve.json", "metrics.jsonl"):
        assert (tmp_path / "parts" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
