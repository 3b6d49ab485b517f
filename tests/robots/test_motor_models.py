"""Robot files state which joints have the same motor, and what its maker states."""

from pathlib import Path

import pytest

from motorprior.exceptions import ArtifactError
from motorprior.robots.load import load_robot
from motorprior.robots.motor_models import MotorModel, StatedValue, is_header_entry

MODEL = """<mujoco><worldbody>
<body><joint name="shoulder" range="-90 90"/><geom size="0.1" mass="1"/>
<body pos="0.3 0 0"><joint name="elbow" range="-90 90"/><geom size="0.1" mass="1"/></body></body>
</worldbody></mujoco>"""
ROBOT = """name = "arm"
motor = "servo"
model = "arm.xml"
base = "fixed"
nominal_pose = 0.0
kp = 10.0
kd = 0.5
torque_limit = 3.0
"""


def robot_with(folder: Path, motors: str):
    (folder / "arm.xml").write_text(MODEL, "utf-8")
    path = folder / "arm.toml"
    path.write_text(ROBOT + motors, "utf-8")
    return load_robot(str(path))


def test_a_model_has_all_joints_and_what_the_maker_states(tmp_path: Path):
    robot = robot_with(tmp_path, "[motors.M1]\ntorque_limit = [3.0, 0.1]\ngear = [1.0, 1.5]\n")

    stated = StatedValue(3.0, 0.1)
    assert robot.motor_models == (
        MotorModel("M1", 1.0, torque_limit=stated),
        MotorModel("M1", 1.5, torque_limit=stated),
    )


def test_without_the_table_no_motor_is_stated(tmp_path: Path):
    assert robot_with(tmp_path, "").motor_models == ()


@pytest.mark.parametrize(
    ("motors", "words"),
    [
        ('[motors.M1]\njoints = ["shoulder"]\n', "joint 'elbow' has no motor"),
        ('[motors.M1]\njoints = ["knee"]\n', "no joint 'knee'"),
        ("[motors.M1]\n[motors.M2]\n", "has two motors"),
        ("[motors.M1]\ngear = [1.0, 1.0, 1.0]\n", "gear has 3 values"),
        ("[motors.M1]\ntorque_limit = 3.0\n", "standard deviation"),
    ],
)
def test_an_error_names_the_model_and_the_joint(tmp_path: Path, motors: str, words: str):
    with pytest.raises(ArtifactError) as error:
        robot_with(tmp_path, motors)

    assert words in str(error.value)
    assert "motors" in str(error.value)


def test_the_entries_of_a_header_give_the_same_model():
    model = MotorModel("M1", 1.5, armature=StatedValue(0.01, 0.3))
    entries = model.as_json()

    assert is_header_entry(entries)
    assert MotorModel.from_json(entries) == model
