"""A policy names what it was trained on by name and digest, and no path in it is followed to anything else."""

import hashlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from motorprior.bench.fleet import fleet_path
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking import motor_provenance
from motorprior.pipeline.walking.motor_provenance import choice_as_json, choice_from_json

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


def test_files_stand_in_it_by_name_and_digest_and_no_absolute_path(choice: MotorChoice, policy: Path, tmp_path: Path):
    said = choice_as_json(choice, policy.parent)
    assert [said[name] for name in FILES] == ["prior.safetensors", "posterior.safetensors", "mine.toml"]
    assert said["prior_sha256"] == hashlib.sha256(b"prior").hexdigest()
    assert str(tmp_path) not in json.dumps(said) and said["kp"] == 3.0


def test_a_shipped_fleet_stands_in_it_by_its_name_alone(policy: Path):
    said = choice_as_json(MotorChoice("fleet", fleet="mixed"), policy.parent)
    assert said["fleet"] == "mixed" and said["fleet_beside"] is said["fleet_sha256"] is None
    assert choice_from_json(said, policy) == MotorChoice("fleet", fleet="mixed")


def test_what_was_written_is_read_back_also_after_a_move(choice: MotorChoice, policy: Path, tmp_path: Path):
    said = choice_as_json(choice, policy.parent)
    (tmp_path / "elsewhere").mkdir()
    for folder in ("inputs", "walk"):
        (tmp_path / folder).rename(tmp_path / "elsewhere" / folder)
    again = choice_from_json(said, tmp_path / "elsewhere" / "walk" / policy.name)
    assert again.prior is not None and again.prior.read_text() == "prior" and again.fleet is not None
    assert Path(again.fleet).resolve() == tmp_path / "elsewhere" / "inputs" / "mine.toml" and again.kp == 3.0
    assert again.limit_follows_gain
    del said["limit_follows_gain"]  # a policy of an earlier version
    assert not choice_from_json(said, tmp_path / "elsewhere" / "walk" / policy.name).limit_follows_gain


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_another_digest_is_refused_by_name(choice: MotorChoice, policy: Path, name: str):
    said = choice_as_json(choice, policy.parent)
    Path(getattr(choice, name)).write_text("changed")
    called = rf"the {name} it was trained on, {said[name]} with SHA-256 {said[f'{name}_sha256'][:16]}"
    with pytest.raises(ConfigError, match=called):
        choice_from_json(said, policy)


def hostile(said: dict[str, Any], tmp_path: Path) -> dict[str, dict[str, Any]]:
    """Changes that name a file with the right contents, or nothing that may be opened."""
    there = tmp_path / "inputs" / "prior.safetensors"
    os.mkfifo(tmp_path / "pipe")
    return {
        "an absolute path": {"prior_beside": str(there)},
        "an absolute name": {"prior": str(there), "prior_beside": None},
        "a path for a name": {"prior": "../inputs/prior.safetensors", "prior_beside": None},
        "a drive": {"prior_beside": f"C:{there}"},
        "a pipe": {"prior_beside": "../pipe"},
        "a device": {"prior_beside": os.path.relpath("/dev/zero", tmp_path / "walk")},
        "a folder": {"prior_beside": ".."},
        "no name at all": {"prior_beside": "a\0b"},
        "too long": {"prior_beside": "a/" * 100_000},
        "no digest": {"prior_sha256": None},
        "another digest": {"prior_sha256": "0" * 64},
        "a fleet without a digest": {"fleet_sha256": None},
        "an absolute fleet": {"fleet": str(tmp_path / "inputs" / "mine.toml"), "fleet_beside": None},
    }


def test_no_path_is_followed_but_to_a_small_file_of_the_digest(choice: MotorChoice, policy: Path, tmp_path: Path):
    said = choice_as_json(choice, policy.parent)
    for what, change in hostile(said, tmp_path).items():
        with pytest.raises(ConfigError, match="is gone or has changed -> put it back, or beside the policy") as refusal:
            choice_from_json(said | change, policy)
        assert len(str(refusal.value)) < 1000, what
    assert choice_from_json(said, policy).kp == 3.0


def test_a_file_that_is_too_large_is_not_opened(choice: MotorChoice, policy: Path, monkeypatch: pytest.MonkeyPatch):
    said = choice_as_json(choice, policy.parent)
    assert choice.prior is not None
    with choice.prior.open("r+b") as file:
        file.truncate(motor_provenance.LARGEST_FILE + 1)
    monkeypatch.setattr(motor_provenance, "digest", lambda path: pytest.fail(f"{path} was read"))
    with pytest.raises(ConfigError, match=r"prior\.safetensors"):
        choice_from_json(said, policy)


@pytest.mark.parametrize("change", [{"more": 1}, {"kp": "high"}, {"prior_sha256": 3}])
def test_what_no_training_wrote_is_refused(choice: MotorChoice, policy: Path, change: dict[str, Any]):
    with pytest.raises(ArtifactError, match="train it again"):
        choice_from_json(choice_as_json(choice, policy.parent) | change, policy)


EARLIER: dict[str, Any] = {
    "actuator": "pd", "armature": 0.0, "delay": 0.0, "fleet": "mixed", "kd": None, "kp": None, "posterior": None,
    "posterior_beside": None, "posterior_sha256": None, "prior": None, "prior_beside": None, "prior_sha256": None,
    "torque_limit": None,
}  # fmt: skip
"""As stored by policies from before fleets had digests."""


@pytest.mark.parametrize("fleet", ["mixed", None])
def test_a_policy_from_before_fleets_had_digests_is_read(policy: Path, fleet: str | None):
    assert choice_from_json(EARLIER | {"fleet": fleet}, policy) == MotorChoice("pd", fleet=fleet)


def test_a_fleet_of_ones_own_without_a_digest_is_refused(policy: Path):
    shutil.copy(fleet_path("mixed"), policy.parent / "mine.toml")
    with pytest.raises(ConfigError, match=r"the fleet it was trained on, mine\.toml with SHA-256 None"):
        choice_from_json(EARLIER | {"fleet": "mine.toml"}, policy)
