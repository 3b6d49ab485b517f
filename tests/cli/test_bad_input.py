"""Bad input ends a command with exit code 2, one line with a remedy, and no partial files."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.actuator.motor_prior import SCHEMA_VERSION
from motorprior.artifacts import read_tensors, write_tensors

Command = Callable[..., Any]
Edit = Callable[[Path], object]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("bench --motors 0", ("--motors 0",)),
        ("bench --seed 99999999999999999999", ("--seed", "to 2147483647")),
        ("bench --fleet nowhere.toml", ("nowhere.toml", ".toml file")),
        ("identify {bench} --preset unknown", ("'unknown'", "rollout", "one_network")),
        ("validate {prior} nowhere.parquet", ("nowhere.parquet", "no such file")),
        ("walk --motors pd:kd=nan", ("--motors 'pd:kd=nan'", "finite number")),
        ("walk --motors pd --task.alive nan", ("--task.alive nan",)),
        ("walk --motors prior", ("file is missing",)),
        ("walk --motors hydraulic:3", ("no motors 'hydraulic'", "fleet, pd, posterior, prior")),
        ("transfer", ("no policy", "walk")),
        ("transfer --walks 2", ("walks needs --study",)),
        ("demo --motors 5", ("--motors 5", "at least 12")),
        ("demo --logs nowhere", ("nowhere", "no such file")),
    ],
)
def test_a_setting_out_of_range_is_named_with_its_bound(
    refused: Command, tmp_path: Path, bench: Path, prior: Path, line: str, words: tuple
):
    refused(*line.format(bench=bench, prior=prior).split(), "--out", tmp_path / "out", words=words)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def test_a_broken_log_is_rejected_by_every_reader(refused: Command, tmp_path: Path, bench: Path):
    copy = shutil.copytree(bench, tmp_path / "bench")
    log = copy / "log.parquet"
    out = ("--out", tmp_path / "out")
    truncate(log)
    commands = (
        ("identify", copy, *out),
        ("logs", "check", log),
        ("logs", "import", log, *out),
    )

    for command in commands:
        refused(*command, words=(str(log), "not a complete Parquet file"))


def resave(**changes: object) -> Edit:
    """An edit that saves a file of tensors with other header entries."""

    def edit(path: Path) -> None:
        tensors, header = read_tensors(path)
        write_tensors(path, tensors, header | changes)

    return edit


BROKEN_PRIORS = {
    "truncated": (truncate, ("not a complete safetensors file",)),
    "newer schema": (
        resave(schema_version=SCHEMA_VERSION + 1),
        (f"schema_version {SCHEMA_VERSION + 1}", f"{SCHEMA_VERSION} -> update motorprior"),
    ),
    "a policy": (resave(kind="policy"), ("a policy, not a motor prior", "identify")),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_PRIORS.values(), ids=list(BROKEN_PRIORS))
def test_a_broken_prior_is_rejected_by_every_reader(
    refused: Command, tmp_path: Path, bench: Path, prior: Path, edit: Edit, words: tuple[str, ...]
):
    copy = Path(shutil.copy(prior, tmp_path / "mine.safetensors"))
    edit(copy)
    out = ("--out", tmp_path / "out")
    words = (str(copy), *words)

    refused("validate", copy, bench / "log.parquet", *out, words=words)
    refused("walk", "--motors", f"prior:{copy}", *out, words=words)


def test_a_prior_of_another_robot_is_refused_by_walk(refused: Command, tmp_path: Path, prior: Path):
    copy = Path(shutil.copy(prior, tmp_path / "mine.safetensors"))
    resave(robot="go1")(copy)
    words = (str(copy), "'go1'", "pupper_v2")

    refused("walk", "--motors", f"prior:{copy}", "--out", tmp_path / "out", words=words)


BROKEN_POLICIES = {
    "other robot": (resave(robot="go1"), ("'go1'", "pupper_v2")),
    "no motors": (resave(provenance={}), ("motors",)),
}


@pytest.mark.parametrize(("edit", "words"), BROKEN_POLICIES.values(), ids=list(BROKEN_POLICIES))
def test_a_broken_policy_is_refused(
    refused: Command, tmp_path: Path, gait_walk: Path, edit: Edit, words: tuple[str, ...]
):
    copy = shutil.copytree(gait_walk, tmp_path / "walk")
    edit(copy / "policy.safetensors")
    words = (str(copy / "policy.safetensors"), *words)

    refused("transfer", copy, "--out", tmp_path / "out", words=words)


def test_a_damaged_checkpoint_is_refused_with_the_remedy_to_delete_it(
    refused: Command, tmp_path: Path, prior: Path
):
    walk = tmp_path / "walk"
    walk.mkdir()
    shutil.copy(prior, walk / "search.safetensors")
    truncate(walk / "search.safetensors")
    line = ("walk", "--motors", "pd", "--out", walk, "--iterations", 1)

    refused(*line, words=(str(walk / "search.safetensors"), "delete it"))


def test_the_process_prints_one_line_and_exits_with_code_2(tmp_path: Path, one_error: Command):
    words = [sys.executable, "-m", "motorprior", "logs", "check", "nowhere.csv"]
    result = subprocess.run(words, capture_output=True, text=True, check=False, cwd=tmp_path)

    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    one_error(result.stderr, ("nowhere.csv", "no such file"))
