"""The commands of the robot's own computer run with numpy, safetensors, pyserial and msgpack only."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from policies import random_policy
from telemetry import telemetry

from motorprior.hardware.deploy import PolicyMotion
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.locomotion import control_step, leg_kinematics, policy, task, trajectory_generator
from motorprior.locomotion.body import body_of
from motorprior.locomotion.control_step import begin_gait, new_gait
from motorprior.logs.formats.robot_run import read_robot_run
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

BARE = Path(__file__).with_name("bare_environment.py")


def in_bare_environment(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(BARE), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_the_bare_environment_is_bare():
    assert "No module named 'numba'" in in_bare_environment("numba").stderr


def test_every_module_of_hardware_can_be_imported():
    folder = Path(policy.__file__).parents[1] / "hardware"
    files = [file.relative_to(folder).with_suffix("") for file in sorted(folder.rglob("*.py"))]
    modules = ["motorprior.hardware." + ".".join(file.parts) for file in files if file.stem != "__init__"]
    assert len(modules) > 15
    code = f"import importlib\nfor name in {modules}: importlib.import_module(name)\nprint('all')"
    done = in_bare_environment("-c", code)
    assert done.stdout == "all\n", done.stderr


def test_the_command_states_what_a_robot_s_computer_can_do():
    done = in_bare_environment("motorprior.__main__", "record", "--help")
    assert done.returncode == 0 and "--excitation" in done.stdout, done.stderr
    done = in_bare_environment("motorprior.__main__", "walk", "--out", "x")
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "`motorprior walk` needs tyro" in done.stderr and "deploy, record, doctor" in done.stderr


@pytest.mark.real_time
def test_a_dry_run_and_the_doctor_send_nothing(virtual: Callable, trot: Path, tmp_path: Path):
    pupper = virtual(currents=True)
    dry = in_bare_environment(
        "motorprior.hardware", "deploy", trot, "--port", pupper.port, "--dry-run", "--seconds", 0.3
    )
    steps = re.search(r"(\d+) control steps, nothing was sent", dry.stderr)  # 100 Hz for 0.3 s, and the last tick
    assert dry.returncode == 0 and steps and 29 <= int(steps[1]) <= 32, dry.stderr
    doctor = in_bare_environment("motorprior.hardware", "doctor", "--port", pupper.port, "--seconds", 1)
    assert doctor.returncode == 0 and "ok  IMU" in doctor.stderr and "ok  joint RL_knee" in doctor.stderr, doctor.stderr
    assert pupper.received == 0


@pytest.mark.real_time
def test_a_recording_is_made_to_its_end(virtual: Callable, tmp_path: Path):
    pupper, out = virtual(suspended=True, currents=True), tmp_path / "run"
    settings = ("--excitation", "chirp", "--joint", "FR_knee", "--seconds", 1, "--yes", "--out", out)
    done = in_bare_environment("motorprior.hardware", "record", "--port", pupper.port, *settings)
    assert done.returncode == 0 and f"recorded {out / 'run.csv'}" in done.stderr, done.stderr
    log = read_robot_run(out / "run.csv", PUPPER_V2)
    assert 0.9 < log.duration < 1.1 and log.joint_torque is not None and (out / "run.json").is_file()


def test_interpreted_and_compiled_formulas_agree(trot: Path, monkeypatch: pytest.MonkeyPatch):
    """To the last bit or two: the compiler may order a product differently, not more."""
    rng, body, pose = np.random.default_rng(0), body_of(PUPPER_V2), spec.NOMINAL_POSE
    modules = (control_step, leg_kinematics, policy, task, trajectory_generator)
    compiled = {name: value for module in modules for name, value in vars(module).items() if hasattr(value, "py_func")}
    names = ("observe", "follow_command", "act", "command_step")
    assert {*names, "low_pass", "joint_targets", "leg_angles", "foot_path"} <= set(compiled)
    interpreted = {name: value.py_func for name, value in compiled.items()}
    given = random_policy(0.3, seed=0, std=0.7, units=3)
    gaits, targets = [new_gait(12, 4), new_gait(12, 4)], []
    seen, action = np.zeros((2, 23)), np.zeros((2, 17))
    for gait in gaits:
        begin_gait(body, gait)
    states = []
    for _ in range(300):
        quaternion = rng.normal(size=4)
        states.append((quaternion / np.linalg.norm(quaternion), rng.normal(0.0, 2.0, 3), rng.normal(0.0, 0.5, 12)))
    for way, functions in enumerate((compiled, interpreted)):
        if way:  # what they call is interpreted too
            for module in modules:
                for name in compiled.keys() & vars(module).keys():
                    monkeypatch.setattr(module, name, interpreted[name])
        path = []
        for step, state in enumerate(states):
            functions["observe"](*state, pose, seen[way])
            functions["follow_command"](body, gaits[way], 0.4, 0.5 * np.sin(0.1 * step), 0.01, seen[way])
            functions["act"](given, seen[way], action[way])
            functions["command_step"](body, action[way], seen[way], gaits[way], 0.01)
            path.append([*seen[way], *gaits[way].target, gaits[way].phase])
        targets.append(path)
    np.testing.assert_allclose(targets[0], targets[1], rtol=0, atol=1e-12)
    monkeypatch.undo()
    motion, still = PolicyMotion(PUPPER_V2, policy.Policy.load(trot)), telemetry(pos=spec.NOMINAL_POSE)
    assert np.all(np.isfinite(motion(Measurement(still, 0.0, 0.0))))
