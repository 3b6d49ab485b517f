"""The commands of the robot's own computer run with numpy, safetensors, pyserial, msgpack and tyro only."""

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
    modules = [
        f"motorprior.hardware.{file.stem}"
        for file in Path(hardware.__file__).parent.glob("[a-z]*.py")
    ]
    assert len(modules) > 10
    code = f"import importlib\nfor name in {modules}: importlib.import_module(name)\nprint('all')\nimport numba"
    done = in_bare_environment("-c", code)
    assert done.stdout == "all\n" and "No module named 'numba'" in done.stderr


def test_the_command_states_what_a_robot_s_computer_can_do():
    done = in_bare_environment("motorprior.__main__", "record", "--help-all")
    assert done.returncode == 0 and "--excitation" in done.stdout, done.stderr
    commands = in_bare_environment("motorprior.__main__", "--help").stdout
    assert re.findall(r"^  (\w+) ", commands, re.MULTILINE) == ["deploy", "record", "doctor"]
    for other in (("walk", "--out", "x"), ("doctor", "--virtual")):
        done = in_bare_environment("motorprior.__main__", *other)
        assert done.returncode == 2 and "pip install" in done.stderr, done.stderr


@pytest.mark.real_time
def test_a_dry_run_and_the_doctor_send_nothing(virtual: Callable, trot: Path, tmp_path: Path):
    pupper = virtual()
    given = ("deploy", trot, "--port", pupper.port, "--dry-run", "--seconds", 0.3)
    dry = in_bare_environment("motorprior.__main__", *given)
    # 100 Hz for 0.3 s, and the last tick
    steps = re.search(r"(\d+) control steps, nothing was sent", dry.stderr)
    assert dry.returncode == 0 and steps and 29 <= int(steps[1]) <= 32, dry.stderr
    doctor = in_bare_environment(
        "motorprior.__main__", "doctor", "--port", pupper.port, "--seconds", 1
    )
    assert doctor.returncode == 0 and "IMU" in doctor.stderr and "RL_knee" in doctor.stderr, (
        doctor.stderr
    )
    assert not pupper.firmware.events


def test_interpreted_and_compiled_formulas_agree(tmp_path: Path):
    """To the last bit or two: the compiler may order a product differently, not more."""
    path = tmp_path / "policy.safetensors"
    as_file_content(random_policy(0.3, seed=0, std=0.7, units=3)).save(path)
    code = Path(replay_policy.__file__).read_text() + f"print(json.dumps(replay({str(path)!r})))"
    interpreted = in_bare_environment("-c", code)
    assert interpreted.returncode == 0, interpreted.stderr
    np.testing.assert_allclose(
        json.loads(interpreted.stdout), replay_policy.replay(path), rtol=0, atol=1e-12
    )
