"""The page of trained policies shows each training once, by the name of its folder."""

from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest

from motorprior.commands.walk import Walk, run_walk
from motorprior.commands.walk_report import build_walk_report
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig


def test_the_page_shows_each_training_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    search = ArsConfig(seed=0, num_directions=2, num_top_directions=2)
    walk = Walk(out=tmp_path / "slow_0", motors="pd", iterations=1, episode_steps=5, workers=1, search=search)
    run_walk(walk)
    run_walk(replace(walk, out=tmp_path / "slow_1", search=replace(search, seed=1)))
    run_walk(replace(walk, out=tmp_path / "pace", gait="pace"))
    page = unescape(build_walk_report(tmp_path, "pupper_v2", "motorprior report", False).read_text("utf-8"))
    assert page.count("data:image/gif") == 2
    assert all(f"Trained on {name}, in its training simulation" in page for name in ("slow", "pace"))


def test_a_folder_without_policies_is_rejected(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"no policy.safetensors"):
        build_walk_report(tmp_path, "pupper_v2", "motorprior report")
