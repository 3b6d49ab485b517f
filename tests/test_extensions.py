"""A new actuator, servo term, log format, robot or excitation needs one file only."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import motorprior

ACTUATOR = """
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.registry import EpisodeMotors, register


@register("soft")
def soft_motors(robot, kp: float = 1.0) -> EpisodeMotors:
    def sample(rng):
        return IdealPd.uniform(robot.num_joints, kp, 0.1 * rng.uniform(0.9, 1.1), 1.0)

    return EpisodeMotors(sample)
"""
USE_ACTUATOR = """
from pathlib import Path
import motorprior as mp
from motorprior.cli.parse import parse
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import policy_runs_of
from motorprior.simulation.motors import simulated_motors
robot = mp.load_robot("pupper_v2")
assert simulated_motors("soft:kp=2", robot).condition == "soft"
assert parse(["walk", "--motors", "soft:kp=2", "--out", "x"])[1].motors == "soft:kp=2"
study = Study(Path("x"), conditions=("soft:kp=2",))
study.require_valid()
assert [run.motors for run in policy_runs_of(study, 0)] == ["soft:kp=2"]
"""
TERM = """    "weak": Term(
        (TermConstant("weakness", "1", 0.1, 1e-6, 0.0),),
        law=lambda p, torque, v, arithmetic: torque * (1.0 - p.weakness),
    ),
"""
USE_TERM = """
import numpy as np
from motorprior.bench.dynamometer import Trial, run
from motorprior.identification.physics.motor_problem import INITIAL_MOTOR, encoded, grey_box
from motorprior.identification.physics.term_selection import SELECTABLE_TERMS
from motorprior.identification.presets import PRESETS
assert "weak" in SELECTABLE_TERMS
def moved(weakness):
    center = encoded(INITIAL_MOTOR | {"weakness": weakness}, ("weak",))
    motors = grey_box(center, ("weak",), PRESETS["rollout"]).motors(np.zeros((1, len(center))))
    target = np.repeat([0.0, 0.3], 20)[:, None]
    return run(motors, Trial(target, 0.0 * target, np.array([0.01]), 0.002)).joint_pos[-1, 0]
assert 0.0 < moved(0.5) < 0.9 * moved(1e-6)
"""
READER = """
import numpy as np
from motorprior.logs.log_reader import LogReader
from motorprior.logs.motor_log import MotorLog


def _read(path, robot):
    time, target, pos = np.loadtxt(path).T
    return MotorLog(
        time=time,
        position_target=target[:, None],
        joint_pos=pos[:, None],
        joint_names=("knee",),
        robot="",
        motor="",
        source=str(path),
    )


READER = LogReader("spaced", (".spaced",), read=_read)
"""
USE_READER = """
import numpy as np, motorprior as mp
time = np.arange(50) * 0.002
np.savetxt("log.spaced", np.stack([time, np.ones(50), np.linspace(0.0, 1.0, 50)], axis=1))
assert mp.read_log("log.spaced").joint_names == ("knee",)
"""
EXCITATION = (
    '    "pulses": Excitation('
    "lambda rng, steps, dt: 0.2 * (np.arange(steps) * dt % 1.0 < rng.uniform(0.1, 0.9))),\n"
)
USE_EXCITATION = """
import motorprior as mp, numpy as np
from motorprior.excitation.robot_targets import excitation_targets, hardware_targets
robot = mp.load_robot("pupper_v2")
targets = excitation_targets(robot, "pulses", 2.0, 0.3, 0)
assert len(set(targets[:, 0])) == 2
targets = hardware_targets(robot, "pulses", (0,), 2.0, amplitude=0.1, speed=9.0, seed=0)
assert np.ptp(targets) > 0.1
"""
ROBOT = """
name = "lever"
motor = "a servo"
model = "lever.xml"
kp = 5.0
kd = 0.3
torque_limit = 2.0
base = "fixed"
nominal_pose = [0.0]
"""
USE_ROBOT = """
from pathlib import Path
import motorprior as mp, numpy as np
Path("lever.xml").write_text('<mujoco><worldbody><body><joint name="hinge" range="-60 60"/>'
    '<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01"/></body></worldbody></mujoco>')
played = mp.simulate("lever.toml", "pd", np.full((20, 1), 0.3))
assert 0.1 < played.joint_pos[-1, 0] < 0.4
"""


@pytest.mark.parametrize(
    ("file", "entry", "text", "use"),
    [
        ("motorprior/actuator/soft.py", "", ACTUATOR, USE_ACTUATOR),
        ("motorprior/actuator/optional_terms.py", "TERMS = {\n", TERM, USE_TERM),
        ("motorprior/logs/readers/spaced.py", "", READER, USE_READER),
        ("motorprior/excitation/hand_made.py", "EXCITATIONS = {\n", EXCITATION, USE_EXCITATION),
        ("lever.toml", "", ROBOT, USE_ROBOT),
    ],
    ids=["actuator", "servo term", "log format", "excitation", "robot"],
)
def test_an_extension_is_one_file(tmp_path: Path, file: str, entry: str, text: str, use: str):
    package = Path(motorprior.__file__).parent
    shutil.copytree(package, tmp_path / "motorprior", ignore=shutil.ignore_patterns("__pycache__"))
    path = tmp_path / file

    if entry:
        content = path.read_text("utf-8")
        assert content.count(entry) == 1
        path.write_text(content.replace(entry, entry + text), "utf-8")
    else:
        path.write_text(text, "utf-8")

    environment = os.environ | {
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{Path(__file__).parent / 'samples'}"
    }
    done = subprocess.run(
        [sys.executable, "-c", use],
        cwd=tmp_path,
        env=environment,
        stderr=subprocess.PIPE,
        check=False,
    )

    assert done.returncode == 0, done.stderr.decode()
