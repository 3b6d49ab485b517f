"""`train_policy` is `walk` without files, which has a line per iteration, however often it was interrupted."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.artifacts import read_json
from motorprior.commands.walk import CURVE, POLICY, Walk, run_walk
from motorprior.locomotion.policy import Policy
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.training import METRICS

SHORT: dict[str, Any] = {"iterations": 1, "episode_steps": 10, "workers": 1}


@pytest.mark.parametrize(
    "options", [{"symmetric": False}, {"hidden_units": 2}, {"hidden_units": 3, "symmetric": False}]
)
def test_symmetry_and_hidden_units_are_those_of_walk(options: dict[str, Any], tmp_path: Path):
    run_walk(Walk(out=tmp_path, motors="fleet", **SHORT, **options))
    walked = Policy.load(tmp_path / POLICY)
    found = mp.train_policy(PUPPER_V2, mp.load_fleet("pupper_v2"), **SHORT, **options)
    assert len(found.arrays.hidden) == options.get("hidden_units", 0) and found.arrays.weights.any(), (
        "or nothing would differ"
    )
    assert found.provenance["symmetric"] == walked.provenance["symmetric"] == options.get("symmetric", True)
    for one, other in zip(found.arrays, walked.arrays, strict=True):
        np.testing.assert_array_equal(one, other)
    assert found.provenance["own_return"] == walked.provenance["own_return"]


def test_a_training_whose_episodes_diverge_keeps_no_policy():
    broken = IdealPd.uniform(12, kp=1e300, kd=1.0, torque_limit=1e308)
    with pytest.raises(mp.SimulationFault, match=r"32 of 32 episodes.*no policy is kept"):
        mp.train_policy(PUPPER_V2, broken, iterations=1, episode_steps=10, workers=1)


class Stops:
    """Progress that interrupts a training after two iterations."""

    iterations = 0

    @contextmanager
    def start(self, name: str, total: int) -> Iterator["Stops"]:
        yield self

    def advance(self, count: int = 1, note: str = "") -> None:
        self.iterations += bool(note)
        if self.iterations == 2:
            raise KeyboardInterrupt

    def note(self, text: str) -> None:
        pass


def test_a_line_contains_the_point_of_the_learning_curve_after_an_interrupt_too(tmp_path: Path):
    walk = Walk(out=tmp_path, motors="pd", iterations=4, episode_steps=20, workers=1)
    with pytest.raises(KeyboardInterrupt):
        run_walk(walk, Stops())
    run_walk(walk)
    lines = [json.loads(line) for line in (tmp_path / METRICS).read_text("utf-8").splitlines()]
    assert lines == read_json(tmp_path / CURVE) and [line["iteration"] for line in lines] == [0, 1, 2, 3]
