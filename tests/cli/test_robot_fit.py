"""What was made for another robot or another clock does not drive this one."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.fleet import fleet_path

Command = Callable[..., Any]


@pytest.fixture
def go1(tmp_path: Path) -> Path:
    """The fleet of another robot."""
    text = fleet_path("pupper_v2").read_text("utf-8")
    path = tmp_path / "go1.toml"
    path.write_text(text.replace('robot = "pupper_v2"', 'robot = "go1"'), "utf-8")
    return path


@pytest.mark.parametrize(
    "line",
    [
        "walk --actuator fleet --out {out}",
        "walk --actuator pd --out {out}",
        "transfer {walk} --out {out}",
        "demo --out {out}",
        "speed --prior {prior} --json {out}",
        "replay {logs} --prior {prior} --out {out}",
    ],
)
def test_a_fleet_of_another_robot_does_not_drive_this_one(
    refused: Command, tmp_path: Path, prior: Path, walk: Path, pupper_logs: Path, go1: Path, line: str
):
    words = line.format(out=tmp_path / "out", prior=prior, walk=walk, logs=pupper_logs).split()
    refused(*words, "--fleet", go1, words=("go1.toml", "'go1'", "'pupper_v2'"))


def test_a_bench_is_of_its_robots_own_motors(refused: Command, tmp_path: Path, go1: Path):
    words = ("bench", "--fleet", go1, "--motors", 1, "--steps", 5, "--out", tmp_path / "out")
    refused(*words, words=("go1.toml", "'go1'", "'pupper_v2'"))


@pytest.mark.parametrize("control_dt", [0.005, 0.02])
def test_a_policy_of_another_control_period_is_not_run(refused: Command, tmp_path: Path, walk: Path, control_dt: float):
    copy = shutil.copytree(walk, tmp_path / "walk")
    path = copy / "policy.safetensors"
    tensors, header = read_tensors(path)
    write_tensors(path, tensors, header | {"control_dt": control_dt})
    words = (str(path), f"{control_dt:g} s", "0.01 s", "train")
    refused("transfer", copy, "--out", tmp_path / "out", words=words)
