"""`motorprior walk` on either engine and any executor, with randomisation; `motorprior speed` measures them all."""

import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_json, read_tensors
from motorprior.exceptions import SimulationFault
from motorprior.locomotion.policy import Policy
from motorprior.search.policy_search import CONTEST_DRAWS
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.randomization import ROBUST
from motorprior.simulation.rollout import WalkSimulator
from motorprior.simulation.timed_paths import TimedPath, measure
from motorprior.simulation.world_step import FAULTS
from motorprior.transfer import study

Command = Callable[..., Any]
SMALL = ("walk", "--actuator", "pd", "--iterations", 1, "--episode-steps", 5)
RESULTS = ("policy.safetensors", "curve.json")


def contents(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in RESULTS]


@pytest.mark.slow
def test_pybullet_trains_and_gives_the_same_bytes_again(motorprior: Command, tmp_path: Path):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")
    few = ("--search.num-directions", 2, "--search.num-top-directions", 1)
    line = (*SMALL, *few, "--engine", "pybullet", "--roughness", 0.01)
    ways = [("serial",), ("threads", "--workers", 2)] + ([("ray", "--workers", 2)] if find_spec("ray") else [])
    for name, *workers in ways:
        assert motorprior(*line, "--executor", name, *workers, "--out", tmp_path / name).code == 0
        assert contents(tmp_path / name) == contents(tmp_path / "serial")
    assert motorprior(*SMALL, *few, "--out", tmp_path / "mujoco").code == 0
    assert contents(tmp_path / "serial") != contents(tmp_path / "mujoco")
    provenance = Policy.load(tmp_path / "serial" / "policy.safetensors").provenance
    assert (provenance["engine"], provenance["roughness"]) == ("pybullet", 0.01)


def test_a_policy_is_measured_where_it_was_trained_or_in_the_engine_asked_for_and_on_one_twin(
    motorprior: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")
    monkeypatch.setattr(study, "DRAWS", 2)
    few = ("--search.num-directions", 1, "--search.num-top-directions", 1)
    walk = ("--engine", "pybullet", "--roughness", 0.03)
    assert motorprior(*SMALL, *few, *walk, "--out", tmp_path / "walk").code == 0

    def figures(name: str, *engine: str) -> dict[str, float]:
        assert motorprior("transfer", tmp_path / "walk", *engine, "--out", tmp_path / name).code == 0
        return read_json(tmp_path / name / "figures.json")

    own, pybullet, mujoco = figures("own"), figures("a", "--engine", "pybullet"), figures("b", "--engine", "mujoco")
    assert own == pybullet
    assert {name.partition("_")[0] for name in own if own[name] != mujoco[name]} == {"own"}
    monkeypatch.setitem(sys.modules, "pybullet", None)
    missing = motorprior("transfer", tmp_path / "walk", "--out", tmp_path / "c")
    assert missing.code == 2
    assert "PyBullet is not installed" in missing.err
    assert "motors" not in missing.err


def test_the_walk_whose_engine_nobody_knows_is_refused(
    refused: Callable[..., None], motorprior: Command, tmp_path: Path
):
    assert motorprior(*SMALL, "--out", tmp_path / "walk").code == 0
    path = tmp_path / "walk" / "policy.safetensors"
    policy = Policy.load(path)
    replace(policy, provenance={**policy.provenance, "engine": "bullet"}).save(path)
    refused("transfer", tmp_path / "walk", "--out", tmp_path / "t", words=("engine = 'bullet'", "pybullet"))


def test_randomisation_is_recorded_with_the_result_and_changes_it(motorprior: Command, tmp_path: Path):
    ranges = ("--randomization.friction", 0.5, 1.5, "--randomization.push", 0.1)
    assert motorprior(*SMALL, "--out", tmp_path / "plain").code == 0
    assert motorprior(*SMALL, *ranges, "--out", tmp_path / "random").code == 0
    recorded = Policy.load(tmp_path / "random" / "policy.safetensors").provenance["randomization"]
    assert (recorded["friction"], recorded["push"], recorded["mass"]) == ([0.5, 1.5], 0.1, list(ROBUST.mass))
    stage = read_json(tmp_path / "random" / "stage.json")["config"]["randomization"]
    assert stage["friction"] == [0.5, 1.5]
    assert contents(tmp_path / "plain") != contents(tmp_path / "random")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--roughness", 0.01), ("--roughness", "pybullet")),
        (("--engine", "pybullet", "--roughness", 1), ("--roughness 1", "0.05")),
        (("--ray-address", "127.0.0.1:6379"), ("--ray-address", "executor ray")),
        (("--randomization.friction", 1.2, 0.8), ("--randomization.friction", "0.8")),
        (("--randomization.sensor-delay", 0, 3), ("--randomization.sensor-delay", "0.2")),
        (("--randomization.push", "nan"), ("--randomization.push", "nan")),
    ],
)
def test_what_cannot_be_is_refused(refused: Callable[..., None], tmp_path: Path, options: tuple, words: tuple):
    refused(*SMALL, *options, "--out", tmp_path / "walk", words=words)


def test_an_engine_or_library_that_is_not_installed_is_named(
    refused: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.setitem(sys.modules, "ray", None)
    out = ("--out", tmp_path / "walk")
    refused(*SMALL, "--engine", "pybullet", *out, words=("PyBullet is not installed", "motorprior[pybullet]"))
    refused(*SMALL, "--executor", "ray", *out, words=("Ray is not installed", "motorprior[ray]"))


def test_episodes_that_fail_cost_no_finished_iteration(
    motorprior: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    line = ("walk", "--actuator", "pd", "--iterations", 3, "--episode-steps", 5, "--workers", 1)
    assert motorprior(*line, "--out", tmp_path / "whole").code == 0
    healthy, episodes = WalkSimulator.run, iter(range(10_000))

    def run(self: WalkSimulator, *args: Any) -> Any:
        if next(episodes) == CONTEST_DRAWS + 70:  # in the third iteration of 32 episodes
            raise SimulationFault("lost", remedy="try again")
        return healthy(self, *args)

    with monkeypatch.context() as context:
        context.setattr(WalkSimulator, "run", run)
        assert motorprior(*line, "--out", tmp_path / "broken").code == 2
    assert int(read_tensors(tmp_path / "broken" / "search.safetensors")[0]["iteration"]) == 2
    assert motorprior(*line, "--out", tmp_path / "broken").code == 0
    assert contents(tmp_path / "broken") == contents(tmp_path / "whole")


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_episodes_that_were_no_physics_are_counted_by_name(motorprior: Command, tmp_path: Path, engine: str):
    if engine == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11")
    wild = ("--kp", 1e8, "--kd", 0, "--torque-limit", 1e9, "--episode-steps", 50)
    line = (
        "walk",
        "--actuator",
        "pd",
        "--iterations",
        2,
        "--search.num-directions",
        2,
        "--search.num-top-directions",
        1,
    )
    result = motorprior(*line, *wild, "--engine", engine, "--out", tmp_path / "walk")
    said = " ".join(result.err.split())
    assert result.code == 2 and f"8 of 8 episodes ended early: {FAULTS[1]}" in said
    assert f"error: each of the 8 episodes broke down ({FAULTS[1]})" in said and "smaller gains" in said
    assert not list((tmp_path / "walk").glob("*.safetensors")), "no policy of nothing, and nothing to go on from"


def test_faults_of_some_episodes_are_told_and_no_error(motorprior: Command, tmp_path: Path, monkeypatch):
    healthy, episodes = WalkSimulator.run, iter(range(100))

    def run(self: WalkSimulator, *args: Any) -> Any:
        episode = healthy(self, *args)
        return replace(episode, fault=1) if next(episodes) - CONTEST_DRAWS in (0, 1, 2) else episode

    monkeypatch.setattr(WalkSimulator, "run", run)
    line = ("walk", "--actuator", "pd", "--iterations", 1, "--episode-steps", 5, "--workers", 1)
    few = ("--search.num-directions", 2, "--search.num-top-directions", 1)
    result = motorprior(*line, *few, "--out", tmp_path)
    assert result.code == 0 and f"3 of 4 episodes ended early: {FAULTS[1]}" in " ".join(result.err.split())
    assert [point["faults"] for point in read_json(tmp_path / "curve.json")] == [{FAULTS[1]: 3}]


def test_speed_tells_of_every_round():
    told: list[str] = []
    paths = {name: TimedPath(10, lambda name=name: told.append(name) or 0.1) for name in "ab"}
    found = measure(paths, 5, lambda: told.append("round"))
    assert told == ["a", "a", "b", "b", "round"] * 5
    assert found.to_figures() == {f"control_steps_per_s/{name}": pytest.approx(100.0) for name in "ab"}


def test_speed_gives_threads_and_clients_back(motorprior: Command, prior: Path, monkeypatch):
    closed: list[object] = []
    for kind in (WalkSimulator, BackendSimulator):
        monkeypatch.setattr(kind, "close", lambda self, close=kind.close: (closed.append(self), close(self)))
    before = set(threading.enumerate())
    assert motorprior("speed", "--prior", prior).code == 0
    assert {thread for thread in threading.enumerate() if thread not in before} == set()
    assert sum(isinstance(each, BackendSimulator) for each in closed) >= 1


def test_speed_writes_a_flat_map_of_every_path(motorprior: Command, tmp_path: Path, prior: Path):
    assert motorprior("speed", "--prior", prior, "--json", tmp_path / "speed.json").code == 0
    figures = read_json(tmp_path / "speed.json")
    paths = {"mj_step", "ideal_pd", "rollout", "physical", "two_threads", "python_numpy"}
    assert {f"control_steps_per_s/{path}" for path in paths} <= set(figures)
    ratios = {"mj_step_share/rollout", "learned_over_pd", "two_threads_over_one", "kernel_over_python_numpy"}
    assert ratios <= set(figures)
    assert all(isfinite(value) and value > 0.0 for value in figures.values())
