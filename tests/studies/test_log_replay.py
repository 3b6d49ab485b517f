"""Replay of logs: logged gains, initial pose and posture, and the error on real logs."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_robot import record_log

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import Fleet, load_fleet, load_robot_fleet, nominal_pd
from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.read_log import read_log, read_log_folder
from motorprior.robots.load import load_robot
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.studies.calibration import FleetProblem
from motorprior.studies.log_replay import (
    FALLEN_TILT,
    Replayer,
    initial_targets,
    logged_constants,
    motors_with_logged_gains,
    replayers_of,
    with_inferred_posture,
    with_posture,
)

BOUND = {"0116": 0.0160, "1_joint": 0.0060, "bf": 0.0165, "lr": 0.0165}
"""Largest error of a replay [rad]; 0.0153, 0.0053, 0.0157 and 0.0158 with the shipped fleet."""

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "robots"
KP = np.linspace(5.0, 7.0, ROBOT.num_joints)
KD = np.linspace(0.5, 0.6, ROBOT.num_joints)


def with_gains(
    log: MotorLog, kp: np.ndarray, kd: np.ndarray | None = None, unit: str = "N·m/rad"
) -> MotorLog:
    """The log with (joints,) gains; without kd, if it is None."""
    logged_kp = np.tile(kp, (log.num_rows, 1))
    logged_kd = None if kd is None else np.tile(kd, (log.num_rows, 1))
    return replace(log, gain_unit=unit, logged_kp=logged_kp, logged_kd=logged_kd)


def mean_error(replayer: Replayer, motors: Actuator) -> float:
    """Mean over joints of the root-mean-square error of the angles [rad]."""
    return float(np.nanmean(replayer.rmse(replayer.joint_pos(motors))))


@pytest.fixture(scope="module")
def log(fleet) -> MotorLog:
    """A log of motors at gains other than the fleet's; the log does not state them."""
    motors = replace(fleet.center(ROBOT.num_joints), kp=KP, kd=KD)
    return with_posture(record_log(motors.actuator()), "suspended")


def test_physical_gains_of_a_log_are_used(log: MotorLog, fleet):
    logged = with_gains(log, KP, KD)
    for motors in (fleet.center(ROBOT.num_joints), nominal_pd(fleet, ROBOT.num_joints)):
        at_logged_gains = motors_with_logged_gains(motors, logged)
        np.testing.assert_array_equal(at_logged_gains.kp, KP)
        np.testing.assert_array_equal(at_logged_gains.kd, KD)


def test_a_log_of_kp_alone_keeps_the_ratio_of_the_gains(log: MotorLog, fleet):
    center = fleet.center(ROBOT.num_joints)
    at_logged_kp = motors_with_logged_gains(center, with_gains(log, KP))
    np.testing.assert_array_equal(at_logged_kp.kp, KP)
    np.testing.assert_allclose(at_logged_kp.kd / at_logged_kp.kp, center.kd / center.kp)


def test_without_physical_gains_in_the_log_the_motors_keep_theirs(log: MotorLog, fleet):
    center = fleet.center(ROBOT.num_joints)
    for without_gains in (log, with_gains(log, KP, KD, "firmware")):
        assert motors_with_logged_gains(center, without_gains) is center
        assert logged_constants(without_gains) == frozenset()


def test_notes_state_posture_and_logged_gains(log: MotorLog, fleet):
    logs = {
        "none": log,
        "physical": with_gains(log, KP, KD),
        "firmware": with_gains(log, KP, KD, "firmware"),
    }
    notes: list[str] = []

    replayers_of(logs, ROBOT, fleet, "auto", notes.append)

    assert len(notes) == 5  # a posture per log, and the gains of two
    assert "none" in notes[0]
    assert "suspended" in notes[0]
    assert "5 to 7 N·m/rad" in notes[2]
    assert "0.5 to 0.6" in notes[2]
    assert "firmware" in notes[4]


def test_a_posture_that_is_given_replaces_the_detected_one(log: MotorLog, fleet):
    (replayer,) = replayers_of({"a": log}, ROBOT, fleet, "standing", print).values()
    assert replayer.log.posture is not None
    assert POSTURES[replayer.log.posture[0]] == "standing"


def test_a_robot_on_a_fixed_base_has_no_posture(fleet):
    with pytest.raises(ConfigError, match="fixed"):
        replayers_of({}, replace(ROBOT, base="fixed"), fleet, "suspended", print)


def fleet_problem(fleet: Fleet, *logs: MotorLog) -> FleetProblem:
    replayers = {}
    for number, log in enumerate(logs):
        replayers[f"log_{number}"] = Replayer(log, ROBOT)
    return FleetProblem(fleet, ROBOT, replayers)


def fitted_constants(fleet: Fleet, *logs: MotorLog) -> set[str]:
    return {parameter.name for parameter in fleet_problem(fleet, *logs).parameters}


def test_a_calibration_fits_the_constants_that_a_log_does_not_state(log: MotorLog, fleet):
    every_constant = fitted_constants(fleet, log)
    with_kp = with_gains(log, KP)
    with_both = with_gains(log, KP, KD)

    assert fitted_constants(fleet, with_kp) == every_constant - {"kp"}
    assert fitted_constants(fleet, with_both) == every_constant - {"kp", "kd_over_kp"}
    assert fleet_problem(fleet, with_both).logged == {"kp", "kd_over_kp"}
    assert fitted_constants(fleet, with_both, log) == every_constant, "the second log has none"


def test_a_calibration_replays_at_logged_gains(log: MotorLog, fleet):
    logged = fleet_problem(fleet, with_gains(log, KP, KD))
    assert logged.rmse("log_0", logged.mean) < 1e-3  # [rad]

    unlogged = fleet_problem(fleet, log)
    assert unlogged.rmse("log_0", unlogged.mean) > 0.004


def test_a_replay_starts_from_the_nearer_of_first_targets_and_nominal_pose():
    pose = np.asarray(ROBOT.nominal_pose)
    targets = np.asarray(ROBOT.nominal_pose) + 0.3

    assert np.array_equal(initial_targets(pose + 0.1, targets, ROBOT), pose)
    assert np.array_equal(initial_targets(pose + 0.2, targets, ROBOT), targets)
    assert np.array_equal(initial_targets(pose, targets, replace(ROBOT, base="fixed")), targets)


def test_an_ideal_pd_at_logged_gains_follows_a_real_go2(shared_data: Path, tmp_path: Path):
    for path in (shared_data / "robots" / "go2.xml", EXAMPLES / "go2.toml"):
        shutil.copy(path, tmp_path)
    robot = load_robot(str(tmp_path / "go2.toml"))
    recording = read_log(shared_data / "go2" / "traj_3.csv.gz", robot, "go2_identification")
    log = with_posture(recording, "suspended")
    pd = nominal_pd(load_robot_fleet(robot, EXAMPLES / "go2_fleet.toml"), robot.num_joints)
    replayer = Replayer(log, robot)

    assert mean_error(replayer, motors_with_logged_gains(pd, log)) < 0.021  # [rad]
    assert mean_error(replayer, pd) > 0.04


@pytest.mark.parametrize("name", BOUND)
def test_the_fleets_central_motor_replays_a_real_log_in_the_detected_posture(
    shared_data: Path, name: str
):
    log = read_log_folder(shared_data / "pupper_v2", ROBOT).logs[name]
    center = load_fleet("pupper_v2").center(ROBOT.num_joints)

    posed, evidence = with_inferred_posture(log, ROBOT, center)

    posture = "suspended" if name == "1_joint" else "standing"
    assert evidence.startswith(posture), evidence
    assert mean_error(Replayer(posed, ROBOT), center.actuator()) <= BOUND[name]


def test_a_logged_posture_is_used_and_the_true_motors_replay_the_log_exactly(fleet):
    center = fleet.center(ROBOT.num_joints)
    motors = center.actuator()
    log = with_posture(record_log(motors, suspended=True), "suspended")

    assert with_inferred_posture(log, ROBOT, center)[0] is log

    assert mean_error(Replayer(log, ROBOT), motors) < 1e-3  # [rad]
    wrong_posture = with_posture(log, "standing")
    assert mean_error(Replayer(wrong_posture, ROBOT), motors) > 10e-3


def test_rows_after_a_fall_are_not_compared(fleet):
    motors = fleet.center(ROBOT.num_joints).actuator()
    log = record_log(motors, suspended=False)
    tilt = np.zeros((log.num_rows, 2))
    spoiled = log.joint_pos.copy()
    tilt[400:550, 0] = FALLEN_TILT + 0.1
    spoiled[400:] = 1.0 + 1e-3 * spoiled[400:]
    tilt[100:110, 1] = -1.5  # a wrong reading is no fall
    fallen = replace(log, base_orientation=tilt, joint_pos=spoiled)
    notes = []

    (replayer,) = replayers_of({"a": fallen}, ROBOT, fleet, "standing", notes.append).values()

    assert replayer.log.posture is not None
    assert {POSTURES[code] for code in replayer.log.posture[400:550]} == {"fallen"}
    assert {POSTURES[code] for code in replayer.log.posture[:400]} == {"standing"}
    assert replayer.compared[:400].all()
    assert not replayer.compared[400:].any()
    assert "200" in notes[0]
    # The spoiled rows are 1 rad away.
    assert mean_error(replayer, motors) < 0.02
