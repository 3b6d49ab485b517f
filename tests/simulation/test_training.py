"""`train_policy` is `walk` without files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import motorprior as mp
from motorprior.commands.walk import Walk, run_walk
from motorprior.locomotion.policy import Policy
from motorprior.progress import Note, Progress
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.training import POLICY

SHORT: dict[str, Any] = {"iterations": 1, "episode_steps": 10, "workers": 1}


@pytest.mark.parametrize(
    "options", [{"symmetric": False}, {"hidden_units": 2}, {"hidden_units": 3, "symmetric": False}]
)
def test_a_trained_policy_is_the_one_that_walk_saves(options: dict[str, Any], tmp_path: Path):
    run_walk(Walk(out=tmp_path, motors="fleet", **SHORT, **options))
    saved = Policy.load(tmp_path / POLICY)

    policy = mp.train_policy(PUPPER_V2, mp.load_fleet("pupper_v2"), **SHORT, **options)

    assert policy.arrays.weights.any(), "or nothing would differ"
    assert len(policy.arrays.hidden) == options.get("hidden_units", 0)
    for array, saved_array in zip(policy.arrays, saved.arrays, strict=True):
        np.testing.assert_array_equal(array, saved_array)

    assert policy.provenance["symmetric"] == options.get("symmetric", True)
    for name in ("symmetric", "best_return"):
        assert policy.provenance[name] == saved.provenance[name]


def test_a_folder_needs_motors_that_can_be_found_again(tmp_path: Path):
    with pytest.raises(mp.ConfigError, match="out"):
        mp.train_policy(PUPPER_V2, mp.load_fleet("pupper_v2"), out=tmp_path, **SHORT)


def test_a_finished_training_is_read_from_its_folder(tmp_path: Path):
    first = mp.train_policy(PUPPER_V2, "fleet", out=tmp_path, **SHORT)
    written = (tmp_path / POLICY).stat().st_mtime_ns

    again = mp.train_policy(PUPPER_V2, "fleet", out=str(tmp_path), **SHORT)

    np.testing.assert_array_equal(again.arrays.weights, first.arrays.weights)
    assert (tmp_path / POLICY).stat().st_mtime_ns == written


@pytest.mark.parametrize(
    ("kp", "warns"),
    [(1.0, True), (8.8, False)],
    ids=["the base sinks to the floor", "the gains of the robot's firmware"],
)
def test_motors_that_do_not_carry_the_robot_are_reported_before_the_training(
    kp: float, warns: bool
):
    notes: list[Note] = []

    mp.train_policy(PUPPER_V2, f"pd:kp={kp},kd=0.1", progress=Progress(notes.append), **SHORT)

    warnings = [note.text for note in notes if note.severity == "warning"]
    assert any("does not stand on these motors" in text for text in warnings) == warns
