"""`motorprior walk` on either engine and any executor, with randomization."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_json
from motorprior.locomotion.policy import Policy
from motorprior.simulation.randomization import ROBUST
from motorprior.studies import compare

Command = Callable[..., Any]
SMALL = ("walk", "--motors", "pd", "--iterations", 1, "--episode-steps", 5)
RESULTS = ("policy.safetensors", "curve.json")


def contents(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in RESULTS]


def test_a_policy_is_measured_where_it_was_trained_or_in_the_engine_asked_for_and_on_one_twin(
    motorprior: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip(
        "pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11"
    )
    monkeypatch.setattr(compare, "NUM_WALKS", 2)
    few = ("--search.num-directions", 1, "--search.num-top-directions", 1)
    assert motorprior(*SMALL, *few, "--engine", "pybullet", "--out", tmp_path / "walk").code == 0

    def figures(name: str, *engine: str) -> dict[str, float]:
        assert (
            motorprior("transfer", tmp_path / "walk", *engine, "--out", tmp_path / name).code == 0
        )
        return read_json(tmp_path / name / "figures.json")

    own = figures("own")
    pybullet = figures("a", "--engine", "pybullet")
    mujoco = figures("b", "--engine", "mujoco")
    assert own == pybullet
    assert {name.partition("_")[0] for name in own if own[name] != mujoco[name]} == {"own"}
    monkeypatch.setitem(sys.modules, "pybullet", None)
    missing = motorprior("transfer", tmp_path / "walk", "--out", tmp_path / "c")
    assert missing.code == 2
    assert "PyBullet is not installed" in missing.err
    assert "motors" not in missing.err


def test_randomisation_is_recorded_with_the_result_and_changes_it(
    motorprior: Command, tmp_path: Path
):
    ranges = ("--randomization.friction", 0.5, 1.5, "--randomization.push", 0.1)
    assert motorprior(*SMALL, "--out", tmp_path / "plain").code == 0
    assert motorprior(*SMALL, *ranges, "--out", tmp_path / "random").code == 0
    recorded = Policy.load(tmp_path / "random" / "policy.safetensors").provenance["randomization"]
    assert (recorded["friction"], recorded["push"], recorded["mass"]) == (
        [0.5, 1.5],
        0.1,
        list(ROBUST.mass),
    )
    assert contents(tmp_path / "plain") != contents(tmp_path / "random")


def test_an_engine_or_library_that_is_not_installed_is_named(
    refused: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    monkeypatch.setitem(sys.modules, "ray", None)
    out = ("--out", tmp_path / "walk")
    refused(
        *SMALL,
        "--engine",
        "pybullet",
        *out,
        words=("PyBullet is not installed", "motorprior[pybullet]"),
    )
    refused(*SMALL, "--executor", "ray", *out, words=("Ray is not installed", "motorprior[ray]"))
