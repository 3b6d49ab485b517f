"""A policy contains the names and digests of the files that it was trained on, and only those files are used."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from motorprior.bench.fleet import fleet_path
from motorprior.exceptions import ConfigError
from motorprior.simulation.motor_choice import MotorChoice
from motorprior.simulation.motor_provenance import choice_as_json, choice_from_json

FILES = ("prior", "posterior", "fleet")


@pytest.fixture
def choice(tmp_path: Path) -> MotorChoice:
    """Of files in a folder beside that of the policy."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    shutil.copy(fleet_path("mixed"), folder / "mine.toml")
    for name in ("prior", "posterior"):
        (folder / f"{name}.safetensors").write_text(name)
    return MotorChoice(
        "prior", folder / "prior.safetensors", folder / "posterior.safetensors", str(folder / "mine.toml"), kp=3.0,
        limit_follows_gain=True,
    )  # fmt: skip


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    (tmp_path / "walk").mkdir()
    return tmp_path / "walk" / "policy.safetensors"


def test_files_are_stored_by_name_and_digest_without_absolute_paths(choice: MotorChoice, policy: Path, tmp_path: Path):
    stored = choice_as_json(choice, policy.parent)
    assert [stored[name] for name in FILES] == ["prior.safetensors", "posterior.safetensors", "mine.toml"]
    assert stored["prior_sha256"] == hashlib.sha256(b"prior").hexdigest()
    assert str(tmp_path) not in json.dumps(stored) and stored["kp"] == 3.0


def test_a_choice_is_read_back_after_its_files_moved(choice: MotorChoice, policy: Path, tmp_path: Path):
    stored = choice_as_json(choice, policy.parent)
    (tmp_path / "elsewhere").mkdir()
    for folder in ("inputs", "walk"):
        (tmp_path / folder).rename(tmp_path / "elsewhere" / folder)
    again = choice_from_json(stored, tmp_path / "elsewhere" / "walk" / policy.name)
    assert again.prior is not None and again.prior.read_text() == "prior" and again.fleet is not None
    assert Path(again.fleet).resolve() == tmp_path / "elsewhere" / "inputs" / "mine.toml" and again.kp == 3.0
    assert again.limit_follows_gain


@pytest.mark.parametrize("name", FILES)
def test_a_changed_file_is_rejected(choice: MotorChoice, policy: Path, name: str):
    stored = choice_as_json(choice, policy.parent)
    Path(getattr(choice, name)).write_text("changed")
    with pytest.raises(ConfigError, match=f"the {name} it was trained on"):
        choice_from_json(stored, policy)
