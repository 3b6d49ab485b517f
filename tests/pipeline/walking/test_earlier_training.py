"""What a training finds in its folder: nothing of it is lost unheard, and the last moment loses nothing."""

from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest

from motorprior.artifacts import read_tensors
from motorprior.exceptions import ConfigError
from motorprior.pipeline import stage
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.stage import MARKER
from motorprior.pipeline.walking import training
from motorprior.pipeline.walking.training import CHECKPOINT
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.search import policy_search
from motorprior.search.ars import ArsConfig


def walk(folder: Path, **changes) -> Walk:
    search = ArsConfig(seed=2, num_directions=2, num_top_directions=2)
    return replace(
        Walk(folder, MotorChoice("pd", kp=8.0), iterations=3, episode_steps=10, workers=1, search=search), **changes
    )


def heard_of(config: Walk) -> str:
    said = StringIO()
    run_walk(config, Lines(said))
    return said.getvalue()


@pytest.fixture
def every_iteration_is_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "_SAVING_SHARE", 1e9)


@pytest.fixture
def killed_before_its_marker(tmp_path: Path, every_iteration_is_saved: None) -> Path:
    """The folder of a training of which everything but the marker is written."""
    folder = tmp_path / "killed"

    def write(path: Path, data: object) -> None:
        if path.name == MARKER:
            raise SystemExit(137)

    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(stage, "write_json", write)
        run_walk(walk(folder))
    return folder


def test_killed_before_its_marker_is_written_a_training_goes_on_from_its_checkpoint(
    killed_before_its_marker: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run_walk(walk(tmp_path / "whole"))
    assert int(read_tensors(killed_before_its_marker / CHECKPOINT)[0]["iteration"]) == 3
    monkeypatch.setattr(policy_search, "advance", None)  # no iteration is made again
    assert run_walk(walk(killed_before_its_marker))
    for name in (POLICY, "curve.json", "metrics.jsonl"):
        assert (killed_before_its_marker / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
    assert (killed_before_its_marker / MARKER).is_file() and not (killed_before_its_marker / CHECKPOINT).exists()


def test_a_finished_policy_of_other_settings_is_replaced_and_that_is_told(tmp_path: Path):
    assert heard_of(walk(tmp_path)).count("\n") == 1, "how long it took"
    said = heard_of(walk(tmp_path, iterations=4, motors=MotorChoice("pd", kp=9.0)))
    assert f"{tmp_path}: the policy that was finished there has other settings" in said
    assert "iterations was 3, is 4" in said and "motors.kp was 8.0, is 9.0" in said and said.count(" was ") == 3
    assert "other settings" not in heard_of(walk(tmp_path / "b"))


def test_a_training_does_not_overwrite_the_policy_that_it_starts_from(tmp_path: Path):
    run_walk(walk(tmp_path))
    before = (tmp_path / POLICY).read_bytes()
    again = walk(tmp_path / "x" / "..", start=tmp_path / POLICY, iterations=1)
    with pytest.raises(ConfigError, match=r"start is policy\.safetensors of the folder out .*-> give another folder"):
        run_walk(again)
    assert (tmp_path / POLICY).read_bytes() == before and (tmp_path / MARKER).is_file()
    assert run_walk(replace(again, out=tmp_path / "further"))
