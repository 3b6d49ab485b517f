"""A file whose values have another type or size than they should is refused in one line, wherever it is read."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.fleet import fleet_path
from motorprior.cli import main as command
from motorprior.cli.speed import Speed

Command = Callable[..., Any]
HUGE = "9" * 400


def resave(path: Path, **changes: object) -> None:
    """The same tensors with other header entries."""
    tensors, header = read_tensors(path)
    write_tensors(path, tensors, header | changes)


@pytest.mark.parametrize(
    "change",
    [
        {"taps": 5},
        {"taps": {}},
        {"taps": ["0"]},
        {"taps": [0, True]},
        {"taps": [0, 10**12]},
        {"provenance": 5},
        {"preset": [1]},
        {"robot": 3},
        {"metrics": None},
        {"period": 10**400},
        {"error_scale": 1e-320},
        {"torque_limit": "1"},
    ],
    ids=lambda change: "-".join(f"{key}" for key in change),
)
def test_a_prior_with_a_header_of_other_types_is_refused(refused: Command, tmp_path: Path, prior: Path, change: dict):
    copy = Path(shutil.copy(prior, tmp_path / "mine.safetensors"))
    resave(copy, **change)
    words = (str(copy), *change)
    refused("validate", copy, "--out", tmp_path / "out", words=words)
    refused("walk", "--prior", copy, "--out", tmp_path / "out", words=words)


@pytest.mark.parametrize(("motors", "words"), [(0, ("0 training motors",)), (11, ("11 training motors", "bench 12"))])
def test_a_prior_that_lacks_motors_of_its_bench_is_refused(
    refused: Command, tmp_path: Path, prior_of_bench: MotorPrior, motors: int, words: tuple[str, ...]
):
    latents = prior_of_bench.mean[:motors]
    path = tmp_path / "few.safetensors"
    replace(prior_of_bench, mean=latents, log_var=latents).save(path)
    for line in (("validate", path), ("walk", "--prior", path)):
        refused(*line, "--out", tmp_path / "out", words=("few.safetensors", "identify it again", *words))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("motors", 10**12),
        ("motors", "many"),
        ("steps", 2.5),
        ("seed", True),
        ("fleet", 5),
        ("preset", [1]),
        ("parameters", {}),
    ],
)
def test_a_prior_whose_bench_has_facts_of_other_types_is_refused(
    refused: Command, tmp_path: Path, prior_of_bench: MotorPrior, key: str, value: object
):
    path = tmp_path / "mine.safetensors"
    replace(prior_of_bench, provenance={"bench": prior_of_bench.provenance["bench"] | {key: value}}).save(path)
    refused("validate", path, "--out", tmp_path / "out", words=("mine.safetensors", "bench"))


def test_the_facts_of_a_bench_are_checked_like_a_fleet_file(refused: Command, tmp_path: Path, bench: Path):
    copy = shutil.copytree(bench, tmp_path / "bench")
    facts = json.loads((copy / "bench.json").read_text())
    facts["parameters"]["delay"] = {"kind": "constant", "center": 1e6}
    (copy / "bench.json").write_text(json.dumps(facts))
    words = ("bench.json", "delay", "from 0 to 1 s", "record the bench again")
    refused("identify", copy, "--out", tmp_path / "out", words=words)


@pytest.mark.parametrize("names", [5, None, "FR_hip", [1, 2], {}])
def test_a_policy_with_other_joint_names_is_refused(refused: Command, tmp_path: Path, walk: Path, names: object):
    copy = shutil.copytree(walk, tmp_path / "walk")
    resave(copy / "policy.safetensors", joint_names=names)
    words = (str(copy / "policy.safetensors"), "joint_names")
    refused("transfer", copy, "--out", tmp_path / "out", words=words)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("kp", "x"),
        ("kp", True),
        ("armature", "x"),
        ("armature", None),
        ("delay", 10**400),
        ("fleet", 5),
        ("prior", 7),
        ("actuator", "servo"),
        ("actuator", ["pd"]),
    ],
)
def test_a_policy_whose_motors_make_no_sense_is_refused(
    refused: Command, tmp_path: Path, walk: Path, key: str, value: object
):
    copy = shutil.copytree(walk, tmp_path / "walk")
    path = copy / "policy.safetensors"
    provenance = read_tensors(path)[1]["provenance"]
    resave(path, provenance=provenance | {"motors": provenance["motors"] | {key: value}})
    refused("transfer", copy, "--out", tmp_path / "out", words=(str(path), key))


@pytest.mark.parametrize("change", [{"delay": 5.0}, {"kp": -1.0}, {"fleet": "unknown"}])
def test_a_policy_whose_motors_are_out_of_range_is_named(refused: Command, tmp_path: Path, walk: Path, change: dict):
    copy = shutil.copytree(walk, tmp_path / "walk")
    path = copy / "policy.safetensors"
    provenance = read_tensors(path)[1]["provenance"]
    resave(path, provenance=provenance | {"motors": provenance["motors"] | change})
    refused("transfer", copy, "--out", tmp_path / "out", words=(str(path), *change))


@pytest.mark.parametrize(
    ("parameter", "number", "words"),
    [
        ("kp", HUGE, ("[kp]", "center", "above 0 to 1e+09")),
        ("kp", "9" * 5000, ("not valid TOML",)),
        ("delay", "1e6", ("[delay]", "center = 1e+06 is not", "from 0 to 1 s")),
        ("velocity_filter", "2.0", ("[velocity_filter]", "above 0 to 1 s")),
    ],
)
def test_a_fleet_with_a_number_beyond_all_bounds_is_refused(
    refused: Command, tmp_path: Path, parameter: str, number: str, words: tuple[str, ...]
):
    head, tail = fleet_path("pupper_v2").read_text("utf-8").split(f"[{parameter}]\n")
    first, rest = tail.split("center = ", 1)
    fleet = tmp_path / "mine.toml"
    fleet.write_text(f"{head}[{parameter}]\n{first}center = {number} # {rest}", "utf-8")
    for line in ("bench", "walk --actuator fleet", "demo"):
        refused(*line.split(), "--fleet", fleet, "--out", tmp_path / "out", words=("mine.toml", *words))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("bench --motors 1000000000000", ("--motors", "to 4096")),
        ("bench --steps 1000000000000", ("--steps", "to 1000000")),
        ("bench --motors 4096 --steps 1000000", ("--motors 4096", "steps 1000000", "fewer")),
        ("demo --motors 1000000000000", ("--motors", "to 4096")),
        ("demo --bench-steps 1000000000000", ("--bench-steps", "to 1000000")),
        ("walk --actuator pd --workers 1000000", ("--workers", "to 1024")),
        ("demo --workers 1000000", ("--workers", "to 1024")),
    ],
)
def test_more_than_a_machine_can_hold_is_refused(refused: Command, tmp_path: Path, line: str, words: tuple[str, ...]):
    refused(*line.split(), "--out", tmp_path / "out", words=words)


def put_angle(log: Path, value: str) -> None:
    lines = log.read_text().splitlines()
    cells = lines[5].split(",")
    cells[14] = value
    lines[5] = ",".join(cells)
    log.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("value", ["1e200", "-101"])
def test_an_angle_no_joint_can_have_is_an_error_and_is_not_replayed(
    refused: Command, motorprior: Command, tmp_path: Path, prior: Path, pupper_logs: Path, value: str
):
    log = pupper_logs / "env_real_tiny_log.csv"
    put_angle(log, value)
    words = (str(log), "joint_pos/FR_hip", "row 4", "100 rad")
    refused("replay", pupper_logs, "--prior", prior, "--out", tmp_path / "out", words=words)
    refused("demo", "--logs", pupper_logs, "--out", tmp_path / "out", words=words)
    outcome = motorprior("logs", "check", log)
    assert outcome.code == 2 and str(log) in outcome.err and "Traceback" not in outcome.err
    assert "error" in outcome.out and "units" in outcome.out


@pytest.mark.parametrize(
    ("failure", "words"),
    [
        (MemoryError("Unable to allocate 7 TiB"), ("not enough memory", "7 TiB")),
        (MemoryError(), ("not enough memory",)),
        (OSError(5, "Input/output error", "a/file"), ("a/file", "Input/output error")),
        (OSError("no device"), ("no device",)),
    ],
)
def test_what_the_machine_refuses_is_one_line(
    motorprior: Command, one_error: Command, monkeypatch: pytest.MonkeyPatch, prior: Path, failure: Exception, words
):
    def fail(config: Speed) -> None:
        raise failure

    monkeypatch.setitem(command.RUN, Speed, fail)
    outcome = motorprior("speed", "--prior", prior)
    assert outcome.code == 2
    one_error(outcome.err, words)


def test_a_number_no_array_can_hold_is_no_prior(tmp_path: Path, prior: Path, refused: Command):
    copy = Path(shutil.copy(prior, tmp_path / "mine.safetensors"))
    tensors, header = read_tensors(copy)
    write_tensors(copy, tensors | {"mean": np.zeros(())}, header)
    refused("validate", copy, "--out", tmp_path / "out", words=("mine.safetensors",))
