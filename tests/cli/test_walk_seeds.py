"""`motorprior walk --seeds N`: one training in the folder itself, several in a folder each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk

SMALL = ("walk", "--actuator", "pd", "--episode-steps", 10, "--iterations", 1)


def test_one_seed_is_the_training_of_the_library(motorprior: Callable[..., Any], tmp_path: Path):
    done = motorprior(*SMALL, "--out", tmp_path / "a")
    assert done.code == 0 and f"see it walk: motorprior play {tmp_path / 'a'}" in done.out
    assert "kept the policy after iteration" in done.out and "m in its own simulation" in done.out
    run_walk(Walk(tmp_path / "b", MotorChoice("pd"), episode_steps=10, iterations=1))
    assert (tmp_path / "a" / "policy.safetensors").read_bytes() == (tmp_path / "b" / "policy.safetensors").read_bytes()


def test_several_seeds_have_a_folder_each_and_one_picture(motorprior: Callable[..., Any], tmp_path: Path):
    done = motorprior(*SMALL, "--out", tmp_path, "--seeds", 2, "--search.seed", 7)
    assert done.code == 0 and "seeds.png" in done.out and "in their own simulation" in " ".join(done.out.split())
    returns = {seed: Policy.load(tmp_path / f"seed_{seed}" / POLICY).provenance["own_return"] for seed in (7, 8)}
    best = max(returns, key=lambda seed: returns[seed])
    assert f"motorprior play {tmp_path / f'seed_{best}'}\n" in done.out
    assert {path.parent.name for path in tmp_path.glob("*/policy.safetensors")} == {"seed_7", "seed_8"}
    judged = motorprior(*SMALL, "--out", tmp_path, "--seeds", 2, "--validation", "mixed")
    assert "Best policies on validation motors (mixed)" in " ".join(judged.out.split())
    assert motorprior(*SMALL, "--out", tmp_path, "--seeds", 0).code == 2
