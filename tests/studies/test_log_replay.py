"""Replay of logs: at logged gains, from the right pose, and within the known error on logs of real robots."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet, load_robot_fleet, nominal_pd
from motorprior.logs.log_folder import read_log_folder
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.read_log import read_log
from motorprior.robots.load import load_robot
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.studies.fleet_problem import FleetProblem
from motorprior.studies.log_replay import (
    Replayer,
    initial_targets,
    logged_constants,
    logged_gains_note,
    prepare,
    with_logged_gains,
)
from motorprior.studies.posture import find_posture, with_posture

# [rad]; 0.0153, 0.0053, 0.0157 and 0.0158 with the shipped fleet
BOUND = {"0116": 0.0160, "1_joint": 0.0060, "bf": 0.0165, "lr": 0.0165}
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "robots"
KP, KD = np.linspace(5.0, 7.0, ROBOT.num_joints), np.linspace(0.5, 0.6, ROBOT.num_joints)


def with_gains(log: MotorLog, kp: np.ndarray, kd: np.ndarray | None = None, unit: str = "N·m/rad") -> MotorLog:
    both = {"stated_kp": kp, "stated_kd": kd}
    rows = {name: None if gain is None else np.tile(gain, (log.num_rows, 1)) for name, gain in both.items()}
    return replace(log, gain_unit=unit, **rows)


@pytest.fixture(scope="module")
def log(record_log, fleet) -> MotorLog:
    """A log of motors at other gains than the fleet's, which it does not state."""
    motors = replace(fleet.center(ROBOT.num_joints), kp=KP, kd=KD)
    return with_posture(record_log(motors.actuator()), "suspended")


def test_physical_gains_are_used_and_firmware_gains_are_not(log: MotorLog, fleet):
    center = fleet.center(ROBOT.num_joints)
    for motors in (center, nominal_pd(fleet, ROBOT.num_joints)):
        found = with_logged_gains(motors, with_gains(log, KP, KD))
        assert np.array_equal(found.kp, KP) and np.array_equal(found.kd, KD)
    found = with_logged_gains(center, with_gains(log, KP))
    assert np.array_equal(found.kp, KP) and np.allclose(found.kd / found.kp, center.kd / center.kp)
    for other in (log, with_gains(log, KP, KD, "firmware")):
        assert with_logged_gains(center, other) is center and logged_constants(other) == frozenset()
    assert logged_gains_note(log) == "" and "kp 5 to 7 N·m/rad and kd 0.5 to 0.6" in logged_gains_note(
        with_gains(log, KP, KD)
    )
    assert "firmware units" in logged_gains_note(with_gains(log, KP, KD, "firmware"))


def test_a_calibration_replays_at_logged_gains_and_fits_the_rest(log: MotorLog, fleet):
    def problem(*logs: MotorLog) -> FleetProblem:
        return FleetProblem(fleet, ROBOT, {f"log_{n}": Replayer(each, ROBOT, each) for n, each in enumerate(logs)})

    def names(found: FleetProblem) -> set[str]:
        return {each.name for each in found.unknowns}

    logged, unlogged = problem(with_gains(log, KP, KD)), problem(log)
    assert names(unlogged) - names(logged) == {"kp", "kd_over_kp"} == logged.logged
    assert logged.rmse("log_0", logged.prior.mean) < 1e-3 < 0.004 < unlogged.rmse("log_0", unlogged.prior.mean)
    assert "kp" not in {logged.unknowns[place].name for place in logged.differing}
    assert names(problem(with_gains(log, KP))) == names(unlogged) - {"kp"}
    assert names(problem(with_gains(log, KP, KD), log)) == names(unlogged), "the second log does not state them"


def test_a_replay_starts_from_the_nearer_of_first_targets_and_nominal_pose():
    pose, targets = np.asarray(ROBOT.nominal_pose), np.asarray(ROBOT.nominal_pose) + 0.3
    assert np.array_equal(initial_targets(pose + 0.1, targets, ROBOT), pose)
    assert np.array_equal(initial_targets(pose + 0.2, targets, ROBOT), targets)
    assert np.array_equal(initial_targets(pose, targets, replace(ROBOT, base="fixed")), targets)


def test_an_ideal_pd_at_logged_gains_follows_a_real_go2(shared_data: Path, tmp_path: Path):
    raw = shared_data / "go2" / "traj_3.csv.gz"
    if not raw.is_file() or not (shared_data / "robots" / "go2.xml").is_file():
        pytest.skip("no logs of a real Go2")
    for path in (shared_data / "robots" / "go2.xml", EXAMPLES / "go2.toml"):
        shutil.copy(path, tmp_path)
    robot = load_robot(str(tmp_path / "go2.toml"))
    log = with_posture(read_log(raw, robot, "go2_identification"), "suspended")
    pd = nominal_pd(load_robot_fleet(robot, EXAMPLES / "go2_fleet.toml"), robot.num_joints)
    replayer = Replayer(log, robot, prepare(log, robot, "traj_3"))
    at_fleets, at_logged = (float(np.nanmean(replayer.run(each).rmse)) for each in (pd, with_logged_gains(pd, log)))
    assert at_logged < 0.021 < 0.04 < at_fleets


@pytest.mark.parametrize("name", BOUND)
def test_the_fleets_central_motor_replays_a_real_log_in_the_detected_posture(shared_data: Path, name: str):
    folder = shared_data / "pupper_v2"
    if not folder.is_dir():
        pytest.skip("no logs of a real Pupper")
    log = read_log_folder(folder, ROBOT).logs[name]
    center, prepared = load_fleet("pupper_v2").center(ROBOT.num_joints).actuator(), prepare(log, ROBOT, name)
    posture = find_posture(log, prepared, ROBOT, center)
    assert posture.name == ("suspended" if name == "1_joint" else "standing"), posture.evidence
    replayer = Replayer(with_posture(log, posture.name), ROBOT, with_posture(prepared, posture.name))
    assert np.nanmean(replayer.run(center).rmse) <= BOUND[name]
