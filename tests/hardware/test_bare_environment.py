"""The commands of the robot's computer need few packages, see docs/hardware.md."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import replay_policy
from policies import as_file_content, random_policy

from motorprior import hardware

BARE = Path(__file__).with_name("bare_environment.py")


def in_bare_environment(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(BARE), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def test_every_module_of_hardware_can_be_imported_without_numba():
    folder = Path(hardware.__file__).parent
    files = [file.relative_to(folder).with_suffix("") for file in folder.rglob("[a-z]*.py")]
    modules = [".".join(("motorprior", "hardware", *file.parts)) for file in files]
    assert len(modules) > 10
    code = f"""
import importlib
for name in {modules}:
    importlib.import_module(name)
print('all')
import numba
"""

    done = in_bare_environment("-c", code)

    assert done.stdout == "all\n"
    assert "No module named 'numba'" in done.stderr


def test_the_command_line_of_the_robots_computer_has_three_commands():
    done = in_bare_environment("motorprior.__main__", "--help")
    assert re.findall(r"^  (\w+) ", done.stdout, re.MULTILINE) == ["deploy", "record", "doctor"]

    done = in_bare_environment("motorprior.__main__", "record", "--help-all")
    assert done.returncode == 0, done.stderr
    assert "--excitation" in done.stdout


@pytest.mark.parametrize("arguments", [("walk", "--out", "x"), ("doctor", "--virtual")])
def test_a_command_that_needs_more_packages_names_their_installation(arguments: tuple[str, ...]):
    done = in_bare_environment("motorprior.__main__", *arguments)
    assert done.returncode == 2, done.stderr
    assert "pip install" in done.stderr


@pytest.mark.real_time
def test_a_dry_run_sends_nothing(virtual: Callable, trot: Path):
    pupper = virtual()
    arguments = ("deploy", trot, "--port", pupper.port, "--dry-run", "--seconds", 0.3)

    dry_run = in_bare_environment("motorprior.__main__", *arguments)

    assert dry_run.returncode == 0, dry_run.stderr
    steps = re.search(r"(\d+) control steps", dry_run.stderr)
    assert steps is not None, dry_run.stderr
    assert 29 <= int(steps[1]) <= 32  # 100 Hz for 0.3 s, and the last tick
    assert not pupper.firmware.events


@pytest.mark.real_time
def test_the_doctor_sends_nothing_and_reports_imu_and_joints(virtual: Callable):
    pupper = virtual()
    arguments = ("doctor", "--port", pupper.port, "--seconds", 1)

    doctor = in_bare_environment("motorprior.__main__", *arguments)

    assert doctor.returncode == 0, doctor.stderr
    assert "IMU" in doctor.stderr
    assert "RL_knee" in doctor.stderr
    assert not pupper.firmware.events


def test_interpreted_and_compiled_formulas_agree(tmp_path: Path):
    """To the last bit or two: the compiler may order a product differently, not more."""
    path = tmp_path / "policy.safetensors"
    as_file_content(random_policy(0.3, seed=0, std=0.7, units=3)).save(path)
    code = Path(replay_policy.__file__).read_text() + f"print(json.dumps(replay({str(path)!r})))"

    done = in_bare_environment("-c", code)

    assert done.returncode == 0, done.stderr
    interpreted = json.loads(done.stdout)
    compiled = replay_policy.replay(path)
    np.testing.assert_allclose(interpreted, compiled, rtol=0, atol=1e-12)
