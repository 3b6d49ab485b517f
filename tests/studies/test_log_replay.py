"""Replay of logs: logged gains, right pose and posture, and the known error on real logs."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_robot import record_log

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import load_fleet, load_robot_fleet, nominal_pd
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

# [rad]; 0.0153, 0.0053, 0.0157 and 0.0158 with the shipped fleet
BOUND = {"0116": 0.0160, "1_joint": 0.0060, "bf": 0.0165, "lr": 0.0165}
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "robots"
KP = np.linspace(5.0, 7.0, ROBOT.num_joints)
KD = np.linspace(0.5, 0.6, ROBOT.num_joints)


def with_gains(
    log: MotorLog, kp: np.ndarray, kd: np.ndarray | None = None, unit: str = "N·m/rad"
) -> MotorLog:
    both = {"logged_kp": kp, "logged_kd": kd}
    rows = {
        name: None if gain is None else np.tile(gain, (log.num_rows, 1))
        for name, gain in both.items()
    }
    return replace(log, gain_unit=unit, **rows)


def mean_error(replayer: Replayer, motors: Actuator) -> float:
    return float(np.nanmean(replayer.rmse(replayer.joint_pos(motors))))


@pytest.fixture(scope="module")
def log(fleet) -> MotorLog:
    """A log of motors at other gains than the fleet's, which it does not state."""
    motors = replace(fleet.center(ROBOT.num_joints), kp=KP, kd=KD)
    return with_posture(record_log(motors.actuator()), "suspended")


def test_physical_gains_are_used_and_firmware_gains_are_not(log: MotorLog, fleet):
    center = fleet.center(ROBOT.num_joints)
    for motors in (center, nominal_pd(fleet, ROBOT.num_joints)):
        found = motors_with_logged_gains(motors, with_gains(log, KP, KD))
        assert np.array_equal(found.kp, KP) and np.array_equal(found.kd, KD)
    found = motors_with_logged_gains(center, with_gains(log, KP))
    assert np.array_equal(found.kp, KP) and np.allclose(found.kd / found.kp, center.kd / center.kp)
    for other in (log, with_gains(log, KP, KD, "firmware")):
        assert (
            motors_with_logged_gains(center, other) is center
            and logged_constants(other) == frozenset()
        )


def test_notes_state_posture_and_logged_gains_and_an_option_overrides_the_posture(
    log: MotorLog, fleet
):
    notes: list[str] = []
    logs = {
        "none": log,
        "physical": with_gains(log, KP, KD),
        "firmware": with_gains(log, KP, KD, "firmware"),
    }
    replayers_of(logs, ROBOT, fleet, "auto", notes.append)
    assert "none" in notes[0] and "suspended" in notes[0] and len(notes) == 5
    assert "5 to 7 N·m/rad" in notes[2] and "0.5 to 0.6" in notes[2] and "firmware" in notes[4]
    (replayer,) = replayers_of({"a": log}, ROBOT, fleet, "standing", notes.append).values()
    assert replayer.log.posture is not None and POSTURES[replayer.log.posture[0]] == "standing"
    with pytest.raises(ConfigError, match="fixed"):
        replayers_of({}, replace(ROBOT, base="fixed"), fleet, "suspended", notes.append)


def test_a_calibration_replays_at_logged_gains_and_fits_the_rest(log: MotorLog, fleet):
    def problem(*logs: MotorLog) -> FleetProblem:
        return FleetProblem(
            fleet, ROBOT, {f"log_{n}": Replayer(each, ROBOT) for n, each in enumerate(logs)}
        )

    def names(found: FleetProblem) -> set[str]:
        return {each.name for each in found.parameters}

    logged = problem(with_gains(log, KP, KD))
    unlogged = problem(log)
    assert names(unlogged) - names(logged) == {"kp", "kd_over_kp"} == logged.logged
    assert logged.rmse("log_0", logged.mean) < 1e-3 < 0.004 < unlogged.rmse("log_0", unlogged.mean)
    assert names(problem(with_gains(log, KP))) == names(unlogged) - {"kp"}
    assert names(problem(with_gains(log, KP, KD), log)) == names(unlogged), (
        "the second log does not state them"
    )


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
    log = with_posture(
        read_log(shared_data / "go2" / "traj_3.csv.gz", robot, "go2_identification"), "suspended"
    )
    pd = nominal_pd(load_robot_fleet(robot, EXAMPLES / "go2_fleet.toml"), robot.num_joints)
    replayer = Replayer(log, robot)
    at_fleets, at_logged = (
        mean_error(replayer, each) for each in (pd, motors_with_logged_gains(pd, log))
    )
    assert at_logged < 0.021 < 0.04 < at_fleets


@pytest.mark.parametrize("name", BOUND)
def test_the_fleets_central_motor_replays_a_real_log_in_the_detected_posture(
    shared_data: Path, name: str
):
    log = read_log_folder(shared_data / "pupper_v2", ROBOT).logs[name]
    center = load_fleet("pupper_v2").center(ROBOT.num_joints)
    posed, evidence = with_inferred_posture(log, ROBOT, center)
    assert evidence.startswith("suspended" if name == "1_joint" else "standing"), evidence
    assert mean_error(Replayer(posed, ROBOT), center.actuator()) <= BOUND[name]


def test_a_logged_posture_is_used_and_the_true_motors_replay_the_log_exactly(fleet):
    center = fleet.center(ROBOT.num_joints)
    motors = center.actuator()
    log = with_posture(record_log(motors, suspended=True), "suspended")
    assert with_inferred_posture(log, ROBOT, center)[0] is log
    suspended, standing = (
        mean_error(Replayer(each, ROBOT), motors) for each in (log, with_posture(log, "standing"))
    )
    assert suspended < 1e-3 < 10e-3 < standing


def test_rows_after_a_fall_are_not_compared(fleet):
    motors = fleet.center(ROBOT.num_joints).actuator()
    notes = []
    log = record_log(motors, suspended=False)
    tilt = np.zeros((log.num_rows, 2))
    spoiled = log.joint_pos.copy()
    tilt[400:550, 0] = FALLEN_TILT + 0.1
    spoiled[400:] = 1.0 + 1e-3 * spoiled[400:]
    tilt[100:110, 1] = -1.5  # a wrong reading is no fall
    fallen = replace(log, base_orientation=tilt, joint_pos=spoiled)
    (replayer,) = replayers_of({"a": fallen}, ROBOT, fleet, "standing", notes.append).values()
    assert replayer.log.posture is not None
    assert {POSTURES[code] for code in replayer.log.posture[400:550]} == {"fallen"}
    assert {POSTURES[code] for code in replayer.log.posture[:400]} == {"standing"}
    assert replayer.compared[:400].all() and not replayer.compared[400:].any() and "200" in notes[0]
    assert mean_error(replayer, motors) < 0.02 < 1.0, "spoiled rows would dominate"
