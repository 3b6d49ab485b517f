"""deploy, record, doctor and virtual-robot from the command line: against virtual robots, and with bad input."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policies import as_file_content

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.identification.physics import term_selection
from motorprior.identification.presets import identification_preset
from motorprior.identification.training_data.windows import training_data
from motorprior.locomotion.policy import zero_policy
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.formats.robot_run import read_robot_run
from motorprior.robots import load
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

pytestmark = pytest.mark.real_time


def policy_file(path: Path, **changes) -> Path:
    """Zero weights: a trot."""
    as_file_content(zero_policy(12), **changes).save(path)
    return path


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine that runs tests has other things to do: a host may be late."""
    late = {"tick_delay": 100.0, "late_ticks": 100, "stalled_time": 100.0, "telemetry_age": 0.5, "watchdog": 0.5}
    wire = PUPPER_V2.require_wire()
    lenient = replace(PUPPER_V2, wire=replace(wire, safety=replace(wire.safety, **late)))
    monkeypatch.setattr(load, "SHIPPED", (lenient,))


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    return policy_file(tmp_path / "policy.safetensors")


def test_a_policy_walks_a_virtual_robot_and_leaves_a_log(motorprior: Callable, policy: Path, tmp_path: Path):
    out = tmp_path / "run"
    done = motorprior(
        "deploy", policy, "--virtual", "--robot.no-homing", "--forward", 0.1, "--seconds", 0.5, "--yes", "--out", out
    )
    assert done.code == 0, done.err
    assert "period_jitter_ms/p99" in done.out and "stopped by time" in done.err
    facts = json.loads((out / "run.json").read_text())
    assert facts["gains"] == {"kp": 50.0, "kd": 5.0, "max_current": 7.0} and facts["policy"] == str(policy)
    assert json.loads((out / "figures.json").read_text())["control_steps"] >= 40
    log = read_robot_run(out / "run.csv", PUPPER_V2)
    assert log.num_joints == 12 and 1.3 < log.duration < 4.0, "half a second, and one to come to rest"


def test_a_walk_with_currents_trains_torque_regression_and_is_no_hung_recording(
    motorprior: Callable, refused: Callable, policy: Path, tmp_path: Path
):
    """The paper's remedy for the distribution shift: torque from the current, recorded while the policy walks."""
    walk, robot = tmp_path / "walk", ("--virtual", "--robot.no-homing", "--robot.currents")
    done = motorprior("deploy", policy, *robot, "--forward", 0.1, "--seconds", 1, "--yes", "--out", walk)
    assert done.code == 0, done.err
    done = motorprior("logs", "import", walk / "run.csv", "--out", tmp_path / "log")
    assert done.code == 0, done.err
    imported = tmp_path / "log" / "run.parquet"
    done = motorprior("identify", imported, "--preset", "paper", "--steps", 2, "--out", tmp_path / "prior")
    assert done.code == 0, done.err
    assert len(MotorPrior.load(tmp_path / "prior" / "prior.safetensors").mean) == 12
    refused("identify", imported, "--out", tmp_path / "no", words=("no load_inertia",))
    words = ("no row in which the robot was excited", "run.csv")
    refused("logs", "import", walk / "run.csv", "--hung", "--out", tmp_path / "no", words=words)


def test_an_excitation_becomes_a_log_that_priors_adapt_to_and_are_identified_from(
    motorprior: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(term_selection, "ORDER", ())  # the terms are tested elsewhere, and take a minute
    out = tmp_path / "rec"
    settings = ("--robot.no-homing", "--robot.rate", 200, "--robot.currents", "--excitation", "chirp", "--seconds", 2)
    done = motorprior("record", "--virtual", *settings, "--yes", "--out", out)
    assert done.code == 0, done.err
    checked = motorprior("logs", "check", out / "run.csv")
    assert checked.code == 0 and "12 joints, 2.0 s" in " ".join(checked.out.split()), checked.out
    assert read_robot_run(out / "run.csv", PUPPER_V2).joint_torque is not None
    done = motorprior("logs", "import", out / "run.csv", "--hung", "--out", tmp_path / "log")
    assert done.code == 0, done.err
    log = read_parquet(tmp_path / "log" / "run.parquet")
    assert log.joint_torque is None and 1.8 < log.duration < 2.1, "a current is not the joint's torque"
    assert np.median(np.diff(log.time)) == pytest.approx(spec.PHYSICS_DT)
    data = training_data(log, identification_preset("rollout"), "the recording")
    assert data.series.shape[0] == 12 and len(data.starts) > 100
    done = motorprior("identify", tmp_path / "log" / "run.parquet", "--steps", 2, "--out", tmp_path / "prior")
    assert done.code == 0 and "12 motors say little" in done.err, done.err
    prior = MotorPrior.load(tmp_path / "prior" / "prior.safetensors")
    assert (prior.robot, len(prior.mean)) == (spec.ROBOT_NAME, 12) and prior.provenance["log"] == str(out / "run.csv")


def test_a_robot_that_lives_for_a_second(motorprior: Callable, tmp_path: Path):
    done = motorprior("virtual-robot", "--seconds", 0.3, "--json", tmp_path / "life.json", "--link", tmp_path / "port")
    assert done.code == 0 and "now ho" in done.err, done.err  # homing, or holding on a quick machine
    life = json.loads((tmp_path / "life.json").read_text())
    assert life["targets"] == 0 and life["mode"].startswith("ho") and not (tmp_path / "port").is_symlink()


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("deploy {policy} --port a --virtual", ("--port a and --virtual", "one of them")),
        ("deploy {policy} --robot.seed 3", ("without --virtual",)),
        ("deploy {policy} --port /dev/ttyNONE --yes", ("no port", "/dev/ttyNONE")),
        ("deploy {policy} --port /dev/null", ("no terminal to confirm at", "--yes")),
        ("deploy {policy} --port /dev/null --yes", ("/dev/null",)),
        ("deploy no.safetensors --virtual --yes", ("no such file",)),
        ("deploy {other_gains} --port /dev/null --yes", ("kp = 22.2", "give kp 22.2")),
        ("deploy {stiff_gains} --port /dev/null --yes", ("kp = 75.0", "-> train it with")),
        ("deploy {slow} --port /dev/null --yes", ("0.02 s", "0.01 s")),
        ("deploy {policy} --port /dev/null --yes --kp 90", ("--kp 90", "at most 60")),
        ("deploy {policy} --port /dev/null --yes --forward 2", ("--forward 2", "at most 0.5")),
        ("deploy {policy} --port /dev/null --yes --forward -0.3", ("--forward -0.3", "at least -0.2")),
        ("deploy {policy} --port /dev/null --yes --yaw-rate 1", ("--yaw-rate 1", "at most 0.6")),
        ("deploy {policy} --port /dev/null --yes --seconds 0", ("--seconds 0",)),
        ("deploy {policy} --port /dev/null --yes --max-current 12", ("--max-current 12", "at most 7")),
        ("record --port /dev/null --yes --joint tail", ("--joint 'tail'", "FR_abduction")),
        ("record --port /dev/null --yes --amplitude 3", ("--amplitude 3", "at most 1.5")),
        ("record --port /dev/null --yes --speed 0", ("--speed 0",)),
        ("record --port /dev/null --yes --seconds 0.1", ("--seconds 0.1", "at least 1")),
        ("record --port /dev/null --yes --seed -1", ("--seed -1",)),
        ("doctor --port /dev/null --seconds 0", ("--seconds 0", "at least 1")),
        ("virtual-robot --robot.rate 50", ("--rate 50", "100 or 200")),
        ("virtual-robot --robot.drop 2", ("--drop 2", "to 1")),
        ("virtual-robot --robot.fault melted@3", ("--fault 'melted@3'", "unplugged")),
        ("virtual-robot --robot.fleet none", ("no fleet 'none'", "pupper_v2")),
        ("logs import {raw} --period 0 --out x", ("--period 0",)),
        ("logs import none.csv --hung --out x", ("none.csv: no such file",)),
        ("logs import none.csv --out x", ("none.csv: no such file",)),
    ],
)
def test_bad_input_is_refused_in_one_line(
    refused: Callable, tmp_path: Path, pupper_logs: Path, command: str, words: tuple[str, ...]
):
    files = {
        "policy": policy_file(tmp_path / "policy.safetensors"),
        "other_gains": policy_file(tmp_path / "gains.safetensors", kp=np.full(12, 4.0)),
        "stiff_gains": policy_file(tmp_path / "stiff.safetensors", kp=np.full(12, 13.5)),
        "slow": policy_file(tmp_path / "slow.safetensors", control_dt=0.02),
        "raw": next(pupper_logs.iterdir()),
    }
    refused(*command.format(**files).split(), words=words)


def test_a_folder_in_use_is_not_overwritten(motorprior: Callable, policy: Path, tmp_path: Path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.csv").write_text("precious")
    done = motorprior("record", "--virtual", "--robot.no-homing", "--yes", "--out", tmp_path / "run")
    assert done.code == 2 and "exists already" in done.err
    assert (tmp_path / "run" / "run.csv").read_text() == "precious"


def test_a_virtual_robot_does_not_outlive_the_command_that_started_it(tmp_path: Path):
    """However that ends: here it is killed."""
    link = tmp_path / "port"
    robot = [sys.executable, "-m", "motorprior.cli.main", "virtual-robot", "--with-parent", "--link", str(link)]
    parent = subprocess.Popen([sys.executable, "-c", f"import subprocess; subprocess.run({robot})"])
    try:
        _wait(link.is_symlink)
    finally:
        parent.kill()
        parent.wait()
    _wait(lambda: not link.is_symlink())


def _wait(condition: Callable[[], bool], patience: float = 60.0) -> None:
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)
