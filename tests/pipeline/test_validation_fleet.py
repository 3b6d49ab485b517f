"""A training whose contests are walked on another fleet's motors."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walk import POLICY, Walk, run_walk, scene
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.search.ars import ArsConfig
from motorprior.search.policy_search import CONTEST, CONTEST_DRAWS, episode_seed


def walk(folder: Path, **changes) -> Walk:
    search = ArsConfig(seed=2, num_directions=2, num_top_directions=2)
    return Walk(folder, MotorChoice("pd"), iterations=3, episode_steps=30, search=search, **changes)


def test_the_policy_that_is_kept_has_the_score_that_it_has_on_the_validation_fleet(tmp_path: Path):
    config = walk(tmp_path, validation="mixed")
    run_walk(config)
    policy = Policy.load(tmp_path / POLICY)
    there = scene(config, policy.commanded(PUPPER_V2), MotorChoice("fleet", fleet="mixed")).simulator()
    seeds = [episode_seed(config.search.seed, CONTEST, draw) for draw in range(CONTEST_DRAWS)]
    score = np.mean([there.run(policy.arrays(), seed).total for seed in seeds])
    assert policy.provenance["own_return"] == score
    assert policy.provenance["validation"] == "mixed"


def test_other_judges_change_no_training(tmp_path: Path):
    for name, fleet in (("own", None), ("other", "mixed")):
        run_walk(walk(tmp_path / name, validation=fleet))
    assert (tmp_path / "own" / "metrics.jsonl").read_bytes() == (tmp_path / "other" / "metrics.jsonl").read_bytes()


def test_a_fleet_that_is_not_there_and_no_patience_are_refused(tmp_path: Path):
    with pytest.raises(ArtifactError, match="no fleet 'nobody'"):
        run_walk(walk(tmp_path / "a", validation="nobody"))
    with pytest.raises(ConfigError, match="patience"):
        run_walk(walk(tmp_path / "b", patience=0))
    assert not (tmp_path / "a").exists() and not (tmp_path / "b").exists()
