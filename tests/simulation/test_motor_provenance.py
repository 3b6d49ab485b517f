"""A policy names the files that it was trained on, with their digests, and accepts no other."""

import hashlib
import json
import re
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
"""Options that name a file, per model of motors."""

MORE_OPTIONS = {
    "posterior": {"limit_follows_gain": True},
    "prior": {"latent_spread": 0.5},
    "pd": {"kp": 3.0},
}


@pytest.fixture(params=OPTIONS)
def text(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Text of motors whose files are in a folder next to the folder of the policy."""
    actuator_name = request.param
    folder = tmp_path / "inputs"
    folder.mkdir()

    files = {}
    for option in OPTIONS[actuator_name]:
        suffix = "toml" if option == "fleet" else "safetensors"
        files[option] = folder / f"{option}.{suffix}"
        shutil.copy(fleet_path("mixed"), files[option])

    return motor_text(actuator_name, **files, **MORE_OPTIONS.get(actuator_name, {}))


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    (tmp_path / "walk").mkdir()
    return tmp_path / "walk" / "policy.safetensors"


def test_motors_are_read_back_after_their_files_moved(text: str, policy: Path, tmp_path: Path):
    stored = motors_as_json(text, policy.parent)
    assert str(tmp_path) not in json.dumps(stored)
    expected = hashlib.sha256(fleet_path("mixed").read_bytes()).hexdigest()
    assert {record["sha256"] for record in stored["files"].values()} == {expected}

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for folder in ("inputs", "walk"):
        (tmp_path / folder).rename(elsewhere / folder)
    text_read_back = motors_from_json(stored, elsewhere / "walk" / policy.name)

    actuator_name, options = parsed(text)
    name_read_back, options_read_back = parsed(text_read_back)
    assert name_read_back == actuator_name
    assert options_read_back.keys() == options.keys()
    for option, value in options.items():
        if isinstance(value, str):
            file = Path(options_read_back[option]).resolve()
            assert file == elsewhere / "inputs" / Path(value).name
        else:
            assert options_read_back[option] == value


def test_a_changed_file_is_rejected(text: str, policy: Path):
    stored = motors_as_json(text, policy.parent)
    _, options = parsed(text)

    for option in stored["files"]:
        file = Path(str(options[option]))
        content = file.read_bytes()
        file.write_text("changed")

        with pytest.raises(ConfigError, match=re.escape(file.name)) as refused:
            motors_from_json(stored, policy)

        assert option in str(refused.value)
        file.write_bytes(content)
