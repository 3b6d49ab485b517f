"""A training in a folder: resumable, with one seed or several, never over the policy that it starts from."""

from dataclasses import replace
from pathlib import Path

import pytest

from motorprior import stage
from motorprior.artifacts import read_tensors
from motorprior.commands.walk import CURVE, PICTURE, POLICY, Walk, run_walk, run_walk_seeds
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.simulation.training_files import CHECKPOINT, METRICS
from motorprior.stage import MARKER


def walk(folder: Path, seed: int = 2, **changes) -> Walk:
    search = ArsConfig(seed=seed, num_directions=2, num_top_directions=2)
    return replace(
        Walk(out=folder, motors="pd:kp=8", iterations=3, episode_steps=10, workers=1, search=search),
        **changes,
    )


def test_killed_before_its_marker_a_training_continues_from_its_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    killed, whole = tmp_path / "killed", tmp_path / "whole"

    def write(path: Path, data: object) -> None:
        raise SystemExit(137)

    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(stage, "write_json", write)
        run_walk(walk(killed))
    run_walk(walk(whole))
    done = int(read_tensors(killed / CHECKPOINT)[0]["iteration"])
    assert 0 < done <= 3 and not (killed / MARKER).exists()
    if done == 3:
        monkeypatch.setattr(PolicySearch, "advance", None)  # no iteration is repeated
    assert run_walk(walk(killed))
    for name in (POLICY, CURVE, METRICS):
        assert (killed / name).read_bytes() == (whole / name).read_bytes(), name
    assert (killed / MARKER).is_file() and not (killed / CHECKPOINT).exists()


def test_a_training_does_not_overwrite_the_policy_that_it_starts_from(tmp_path: Path):
    run_walk(walk(tmp_path))
    before = (tmp_path / POLICY).read_bytes()
    again = walk(tmp_path / "x" / "..", start=tmp_path / POLICY, iterations=1)
    with pytest.raises(ConfigError, match="the training would overwrite"):
        run_walk(again)
    assert (tmp_path / POLICY).read_bytes() == before and (tmp_path / MARKER).is_file()
    assert run_walk(replace(again, out=tmp_path / "further"))


def test_every_seed_is_the_training_of_that_seed_and_is_not_repeated(tmp_path: Path):
    config = walk(tmp_path / "seeds", seed=3, workers=2)
    results = run_walk_seeds(config, 3)
    assert results.distinct("seed") == [3, 4, 5]
    run_walk(walk(tmp_path / "one", seed=4))
    for name in (POLICY, METRICS):
        assert (tmp_path / "seeds" / "seed_4" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
    written = {path: path.stat().st_mtime_ns for path in config.out.glob(f"*/{POLICY}")}
    assert len({path.read_bytes() for path in written}) == 3 and (config.out / PICTURE).is_file()
    assert run_walk_seeds(config, 3) == results
    assert {path: path.stat().st_mtime_ns for path in written} == written
