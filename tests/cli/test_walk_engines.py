"""`motorprior walk` on both engines and any executor, with randomisation."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.artifacts import read_json
from motorprior.commands.transfer import Transfer, run_transfer
from motorprior.locomotion.policy import Policy
from motorprior.simulation.randomization import ROBUST
from motorprior.simulation.scene import Engine

Command = Callable[..., Any]
SMALL = ("walk", "--motors", "pd", "--iterations", 1, "--episode-steps", 5)
RESULTS = ("policy.safetensors", "curve.json")


def contents(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in RESULTS]


def test_a_policy_is_evaluated_in_its_training_engine_or_in_a_chosen_one(
    motorprior: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip(
        "pybullet", reason="PyBullet is not installed: its wheels end at Python 3.11"
    )
    walk = tmp_path / "walk"
    few = ("--search.num-directions", 1, "--search.num-top-directions", 1)

    assert motorprior(*SMALL, *few, "--engine", "pybullet", "--out", walk).code == 0

    def figures(name: str, engine: Engine | None = None) -> dict[str, float]:
        run_transfer(Transfer((walk,), tmp_path / name, engine=engine), num_walks=2)
        return read_json(tmp_path / name / "figures.json")

    of_training_engine = figures("training")
    pybullet = figures("pybullet", "pybullet")
    mujoco = figures("mujoco", "mujoco")

    assert of_training_engine == pybullet

    # the engine changes the figures of the training simulation ("own"), not of the twin
    changed = {name for name in pybullet if pybullet[name] != mujoco[name]}

    assert {name.partition("_")[0] for name in changed} == {"own"}

    monkeypatch.setitem(sys.modules, "pybullet", None)
    missing = motorprior("transfer", walk, "--out", tmp_path / "missing")

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
        words=("PyBullet is not installed", "pip install pybullet"),
    )
    refused(*SMALL, "--executor", "ray", *out, words=("Ray is not installed", "pip install ray"))
