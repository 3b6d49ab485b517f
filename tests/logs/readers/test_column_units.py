"""Every channel of every joint may have a sign, a zero and a unit of its own; what has no effect is refused."""

from pathlib import Path

import numpy as np

from motorprior.logs.column_map import load_column_map
from motorprior.logs.column_units import TURN, Conversion
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.read_log import read_log

MAP = """
motor = "servo"
time = "t"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
joint_vel = "vel_{joint}"
joint_torque = "load_{joint}"
load_stiffness = "pull_{joint}"

[units]
angle = "deg"
velocity = "rpm"

[joints.a]
OF_A
[joints.b]
OF_B
"""
KINDS, ROWS = ("goal", "pos", "vel", "load", "pull"), 20
RAW = np.random.default_rng(0).standard_normal((len(KINDS), 2, ROWS))
DEGREE = TURN / 360.0


def a_map(folder: Path, of_a: str, of_b: str = "", old: str = "", new: str = "") -> Path:
    text = MAP.replace("OF_A", of_a).replace("OF_B", of_b)
    assert old in text
    (folder / "map.toml").write_text(text.replace(old, new) if old else text, "utf-8")
    return folder / "map.toml"


def read(folder: Path, of_a: str, of_b: str = "") -> MotorLog:
    names = ["t", *(f"{kind}_{joint}" for kind in KINDS for joint in "ab")]
    table = np.column_stack([0.01 * np.arange(ROWS), *RAW.reshape(-1, ROWS)])
    np.savetxt(folder / "log.csv", table, delimiter=",", header=",".join(names), comments="", fmt="%.17g")
    return read_log(folder / "log.csv", columns=a_map(folder, of_a, of_b))


def test_an_angle_that_runs_against_its_command_is_turned_alone_with_its_velocity(tmp_path: Path):
    log = read(tmp_path, "[joints.a.joint_pos]\nsign = -1\nzero = 0.5")
    np.testing.assert_allclose(log.position_target[:, 0], DEGREE * RAW[0, 0])
    np.testing.assert_allclose(log.joint_pos[:, 0], 0.5 - DEGREE * RAW[1, 0])
    assert log.joint_vel is not None and log.joint_torque is not None
    np.testing.assert_allclose(log.joint_vel[:, 0], -TURN / 60.0 * RAW[2, 0])
    np.testing.assert_allclose(log.joint_torque[:, 0], RAW[3, 0])
    np.testing.assert_allclose(log.joint_pos[:, 1], DEGREE * RAW[1, 1], err_msg="the other joint")


def test_what_a_channel_says_counts_before_what_its_joint_says(tmp_path: Path):
    of_a = "sign = -1.0\nzero = 0.2\n[joints.a.position_target]\nsign = 1\n[joints.a.joint_vel]\nsign = 1\nscale = 3.0"
    of_b = 'scale = 0.1\n[joints.b.joint_pos]\nangle = "tick"\nticks_per_turn = 1228.8\n'
    log = read(tmp_path, of_a, of_b + '[joints.b.joint_torque]\nsign = -1\ntorque = "mN·m"')
    assert log.joint_vel is not None and log.joint_torque is not None
    np.testing.assert_allclose(log.position_target[:, 0], 0.2 + DEGREE * RAW[0, 0])
    np.testing.assert_allclose(log.joint_pos[:, 0], 0.2 - DEGREE * RAW[1, 0])
    np.testing.assert_allclose(log.joint_vel[:, 0], 3.0 * RAW[2, 0])
    np.testing.assert_allclose(log.joint_torque[:, 0], -RAW[3, 0])
    np.testing.assert_allclose(log.position_target[:, 1], 0.1 * RAW[0, 1])
    np.testing.assert_allclose(log.joint_pos[:, 1], TURN / 1228.8 * RAW[1, 1])
    np.testing.assert_allclose(log.joint_torque[:, 1], -1e-3 * RAW[3, 1])


def test_servos_of_two_kinds_have_ticks_of_their_own(tmp_path: Path):
    path = a_map(tmp_path, "ticks_per_turn = 1024", old='angle = "deg"', new='angle = "tick"\nticks_per_turn = 4096.0')
    first, second = load_column_map(path).joints
    assert first.conversions["joint_pos"] == Conversion(TURN / 1024.0)
    assert second.conversions["position_target"] == Conversion(TURN / 4096.0)
