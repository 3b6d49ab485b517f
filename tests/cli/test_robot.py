"""`deploy`, `record` and `doctor` with virtual robots, and with bad input."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policies import as_file_content, random_policy

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.logs.readers.deploy_recording import read_deploy_recording
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.robots import load
from motorprior.robots.pupper_v2.robot import PUPPER_V2


def policy_file(path: Path, **changes) -> Path:
    """A file of a policy with zero weights, which trots."""
    as_file_content(random_policy(0.0, 0), **changes).save(path)
    return path


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Safety limits that a busy test machine keeps: the host may be late."""
    late = {
        "tick_delay": 100.0,
        "late_ticks": 100,
        "stalled_time": 100.0,
        "telemetry_age": 0.5,
        "watchdog": 0.5,
    }
    wire = PUPPER_V2.require_wire()
    lenient = replace(PUPPER_V2, wire=replace(wire, safety=replace(wire.safety, **late)))
    monkeypatch.setattr(load, "SHIPPED", (lenient, *load.SHIPPED[1:]))


@pytest.mark.real_time
def test_a_walk_with_currents_leaves_a_log_that_trains_torque_regression(
    motorprior: Callable, tmp_path: Path
):
    walk = tmp_path / "walk"
    policy = policy_file(tmp_path / "policy.safetensors")
    robot = ("--virtual", "--virtual-robot.currents")
    options = ("--forward", 0.1, "--seconds", 1, "--yes")
    done = motorprior("deploy", policy, *robot, *options, "--out", walk)

    assert done.code == 0, done.err
    assert "period_jitter_ms/p99" in done.err
    assert "stopped by time" in done.err

    run = json.loads((walk / "run.json").read_text())

    assert run["gains"] == {"kp": 50.0, "kd": 5.0, "max_current": 7.0}
    assert run["policy"] == str(policy)
    assert json.loads((walk / "figures.json").read_text())["control_steps"] >= 80

    recording = walk / "run.csv"
    duration = read_deploy_recording(recording, PUPPER_V2).duration

    assert 1.8 < duration < 5.0, "one second of walking and one to stop"

    done = motorprior("logs", "import", recording, "--period", 0.01, "--out", tmp_path / "log")

    assert done.code == 0, done.err

    log = tmp_path / "log" / "run.parquet"
    fit = ("--preset", "paper", "--steps", 2)
    done = motorprior("identify", log, *fit, "--out", tmp_path / "prior")

    assert done.code == 0, done.err
    assert len(MotorPrior.load(tmp_path / "prior" / "prior.safetensors").mean) == 12


@pytest.mark.real_time
def test_a_recording_in_the_air_becomes_a_log(motorprior: Callable, tmp_path: Path):
    out = tmp_path / "rec"
    virtual_robot = ("--virtual", "--virtual-robot.rate", 200, "--virtual-robot.currents")
    motion = ("--excitation", "chirp", "--seconds", 2)
    done = motorprior("record", *virtual_robot, *motion, "--yes", "--out", out)

    assert done.code == 0, done.err
    for command in (("doctor", "--virtual", "--seconds", 1), ("logs", "check", out / "run.csv")):
        assert motorprior(*command).code == 0

    done = motorprior("logs", "import", out / "run.csv", "--suspended", "--out", tmp_path / "log")

    assert done.code == 0, done.err

    log = read_parquet(tmp_path / "log" / "run.parquet")

    assert log.joint_torque is not None, "the fit judges it against the loads"
    assert 1.8 < log.duration < 2.1
    assert np.median(np.diff(log.time)) == pytest.approx(PUPPER_V2.physics_dt)
    assert log.joint_names == PUPPER_V2.joint_names


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("deploy {policy} --port a --virtual", ("--port a and --virtual",)),
        ("deploy {policy} --port /dev/ttyNONE --yes", ("no port", "/dev/ttyNONE")),
        ("deploy {policy} --port /dev/null", ("no terminal to confirm at", "--yes")),
        ("deploy {other_gains} --port /dev/null --yes", ("kp = 22.2", "give kp 22.2")),
        ("deploy {slow} --port /dev/null --yes", ("0.02", "0.01")),
        ("record --port /dev/null --yes --amplitude 3", ("--amplitude 3", "to 1.5")),
        ("record --port /dev/null --yes --out {used}", ("run.csv", "exists already")),
    ],
)
def test_bad_input_is_refused_with_one_error(
    refused: Callable, tmp_path: Path, command: str, words: tuple[str, ...]
):
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "run.csv").write_text("precious")
    files = {
        "policy": policy_file(tmp_path / "policy.safetensors"),
        "other_gains": policy_file(tmp_path / "gains.safetensors", kp=np.full(12, 4.0)),
        "slow": policy_file(tmp_path / "slow.safetensors", control_dt=0.02),
        "used": tmp_path / "used",
    }

    refused(*command.format(**files).split(), words=words)


@pytest.mark.real_time
def test_a_virtual_robot_ends_when_the_process_that_started_it_is_killed():
    code = """if True:
        import time
        from motorprior.commands.virtual_robot import VirtualRobotSettings, running_virtual_robot

        with running_virtual_robot("pupper_v2", VirtualRobotSettings()) as port:
            print(port, flush=True)
            time.sleep(60.0)
    """
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None

    with parent.stdout:
        port = Path(parent.stdout.readline().strip())

    assert port.exists()

    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 10.0

    while port.exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)
