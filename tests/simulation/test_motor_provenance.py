"""A policy contains the names and digests of the files that it was trained on, and only those files are used."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from motorprior.actuator.fleet import fleet_path
from motorprior.actuator.registry import motor_text, parsed
from motorprior.exceptions import ConfigError
from motorprior.simulation.motors import motors_as_json, motors_from_json

OPTIONS = {
    "posterior": ("file", "prior"),
    "prior": ("file",),
    "fleet": ("fleet",),
    "pd": ("fleet",),
}


@pytest.fixture(params=OPTIONS)
def text(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Motors of files in a folder next to that of the policy."""
    folder = tmp_path / "inputs"
    kind = request.param
    folder.mkdir()
    files = {
        name: folder / f"{name}.{'toml' if name == 'fleet' else 'safetensors'}"
        for name in OPTIONS[kind]
    }
    for file in files.values():
        shutil.copy(fleet_path("mixed"), file)
    more = {
        "posterior": {"limit_follows_gain": True},
        "prior": {"latent_spread": 0.5},
        "pd": {"kp": 3.0},
    }
    return motor_text(kind, **files, **more.get(kind, {}))


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    (tmp_path / "walk").mkdir()
    return tmp_path / "walk" / "policy.safetensors"


def test_motors_are_read_back_after_their_files_moved(text: str, policy: Path, tmp_path: Path):
    stored = motors_as_json(text, policy.parent)
    assert str(tmp_path) not in json.dumps(stored)
    expected = hashlib.sha256(fleet_path("mixed").read_bytes()).hexdigest()
    assert {record["sha256"] for record in stored["files"].values()} == {expected}
    (tmp_path / "elsewhere").mkdir()
    for folder in ("inputs", "walk"):
        (tmp_path / folder).rename(tmp_path / "elsewhere" / folder)
    again = motors_from_json(stored, tmp_path / "elsewhere" / "walk" / policy.name)
    (kind, options), (same_kind, same) = parsed(text), parsed(again)
    assert kind == same_kind and options.keys() == same.keys()
    for name, value in options.items():
        if isinstance(value, str):
            value = tmp_path / "elsewhere" / "inputs" / Path(value).name
            same[name] = Path(same[name]).resolve()
        assert same[name] == value


def test_a_changed_file_is_rejected(text: str, policy: Path):
    stored = motors_as_json(text, policy.parent)
    options = parsed(text)[1]
    for name in stored["files"]:
        file = Path(str(options[name]))
        before = file.read_bytes()
        file.write_text("changed")
        with pytest.raises(ConfigError, match=f"the {name} it was trained on"):
            motors_from_json(stored, policy)
        file.write_bytes(before)
