"""Recordings of servos: what they state, times of commands, damaged files."""

from pathlib import Path

import numpy as np
import pytest
from servo_recordings import JOINTS, write_servo_recording

from motorprior.exceptions import LogError
from motorprior.logs.load_log import load_log
from motorprior.logs.read_log import read_log
from motorprior.logs.readers.servo_recording import read_servo_recording


def test_the_log_states_gains_registers_and_conditions_without_a_column_map(tmp_path: Path):
    log = read_log(write_servo_recording(tmp_path))

    assert log.joint_names == JOINTS
    assert log.gain_unit == "firmware"
    assert log.gains is not None
    assert log.gains[0].tolist() == [16.0, 32.0]
    assert log.firmware == {"dead_zone": 0.0, "profile_acceleration": 39.0}
    assert log.operating_conditions["supply_voltage"].tolist() == [12.0, 12.0]
    assert log.operating_conditions["motor_temperature"].tolist() == [30.0, 30.0]
    assert len(log.segment_slices()) == 2


@pytest.mark.parametrize("write_delay", [0.0, 0.001, 0.003])
def test_commands_act_from_the_time_at_which_they_were_written(tmp_path: Path, write_delay: float):
    path = write_servo_recording(tmp_path, rows=200, parts=1, write_delay=write_delay)
    log = read_servo_recording(path, period=0.001)
    time = log.time[20:-20]

    # held targets are late by half a period on average
    written = 0.1 * np.sin(10.0 * (time + 0.0005 - write_delay - 0.002))

    assert np.abs(log.position_target[20:-20, 0] - written).max() < 0.0025
    mean_error = np.mean(log.position_target[20:-20, 0] - written)
    assert abs(mean_error) < 2e-4


def test_a_pendulum_has_its_load(tmp_path: Path):
    pendulum = {"length": 0.1, "mass": 0.5, "bar_mass": 0.06}
    path = write_servo_recording(
        tmp_path, joint_names=["pendulum"], joint_classes=["pendulum"], p_gains=[400],
        robot="pendulum", pendulum=pendulum, motor="XL330-M288",
    )  # fmt: skip
    log = load_log(path)

    assert log.load_inertia is not None
    assert log.external_torque is not None
    np.testing.assert_allclose(log.load_inertia, (0.5 + 0.02) * 0.01)
    torque = -(0.5 + 0.03) * 9.81 * 0.1 * np.sin(log.joint_pos)
    np.testing.assert_allclose(log.external_torque, torque)


def test_only_a_motor_without_robot_has_the_stall_torque_of_its_maker(tmp_path: Path):
    alone = {"joint_names": ["pendulum"], "joint_classes": ["pendulum"], "p_gains": [400]}
    bar = {"length": 0.1, "mass": 0.5, "bar_mass": 0.06}
    log = read_log(write_servo_recording(tmp_path, **alone, pendulum=bar, motor="XL330-M288"))
    (model,) = log.motor_models
    assert model.torque_limit is not None
    assert (model.name, model.torque_limit.value) == ("XL330-M288", 0.52)

    # servos of a robot may have gears behind them
    assert read_log(write_servo_recording(tmp_path, motor="XL330-M288")).motor_models == ()


def test_a_cut_last_line_is_ignored(tmp_path: Path):
    whole = read_log(write_servo_recording(tmp_path))
    cut = read_log(write_servo_recording(tmp_path, end="0.16,3,1,0."))

    np.testing.assert_array_equal(cut.joint_pos, whole.joint_pos)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("# motorprior servo", "# another", "not a recording of servos"),
        ('"version": 1', '"version": 9', "version"),
        ("joint_pos/pan", "joint_pos/x", "columns"),
        ("0.004,3,0", "zero,3,0", "row 1"),
        ("0.008,3,0", "nan,3,0", "row 2"),
    ],
)
def test_a_damaged_recording_is_refused_by_row(tmp_path: Path, old: str, new: str, words: str):
    path = write_servo_recording(tmp_path)
    path.write_text(path.read_text().replace(old, new))

    with pytest.raises(LogError, match=words) as refusal:
        read_log(path)
    assert refusal.value.where == path
