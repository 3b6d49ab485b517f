"""Motors that replay a log have the gains that it states, and a calibration does not fit these."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.motor_choice import load_robot_fleet, nominal_pd
from motorprior.robots.load import load_robot
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.transfer.fleet_problem import FleetProblem
from motorprior.transfer.posture import with_posture
from motorprior.transfer.real_replay import Replayer, held_before, prepare
from motorprior.transfer.stated_gains import at_stated_gains, stated_constants, told_of_gains

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "robots"
KP, KD = np.linspace(5.0, 7.0, ROBOT.num_joints), np.linspace(0.5, 0.6, ROBOT.num_joints)


def stating(log: MotorLog, kp: np.ndarray, kd: np.ndarray | None = None, unit: str = "N·m/rad") -> MotorLog:
    both = {"stated_kp": kp, "stated_kd": kd}
    rows = {name: None if gain is None else np.tile(gain, (log.num_rows, 1)) for name, gain in both.items()}
    return replace(log, gain_unit=unit, **rows)


@pytest.fixture(scope="module")
def log(record_log, fleet) -> MotorLog:
    """Of motors at other gains than the fleet's, which it does not state."""
    motors = replace(fleet.center(ROBOT.num_joints), kp=KP, kd=KD)
    return with_posture(record_log(motors.actuator()), "hung")


def test_gains_in_units_of_a_motor_are_taken_and_others_are_not(log: MotorLog, fleet):
    center = fleet.center(ROBOT.num_joints)
    for motors in (center, nominal_pd(fleet, ROBOT.num_joints)):
        told = at_stated_gains(motors, stating(log, KP, KD))
        assert np.array_equal(told.kp, KP) and np.array_equal(told.kd, KD)
    told = at_stated_gains(center, stating(log, KP))
    assert np.array_equal(told.kp, KP) and np.allclose(told.kd / told.kp, center.kd / center.kp)
    for other in (log, stating(log, KP, KD, "firmware")):
        assert at_stated_gains(center, other) is center and stated_constants(other) == frozenset()
    assert told_of_gains(log) == "" and "kp 5 to 7 N·m/rad and kd 0.5 to 0.6" in told_of_gains(stating(log, KP, KD))
    assert "units of the firmware" in told_of_gains(stating(log, KP, KD, "firmware"))


def test_a_calibration_replays_at_stated_gains_and_fits_the_rest(log: MotorLog, fleet):
    def problem(*logs: MotorLog) -> FleetProblem:
        return FleetProblem(fleet, ROBOT, {f"log_{n}": Replayer(each, ROBOT, each) for n, each in enumerate(logs)})

    def names(found: FleetProblem) -> set[str]:
        return {each.name for each in found.unknowns}

    stated, silent = problem(stating(log, KP, KD)), problem(log)
    assert names(silent) - names(stated) == {"kp", "kd_over_kp"} == stated.stated
    assert stated.rmse("log_0", stated.belief.mean) < 1e-3 < 0.004 < silent.rmse("log_0", silent.belief.mean)
    assert "kp" not in {stated.unknowns[place].name for place in stated.differing}
    assert names(problem(stating(log, KP))) == names(silent) - {"kp"}
    assert names(problem(stating(log, KP, KD), log)) == names(silent), "the second log does not state them"


def test_a_replay_begins_from_what_the_robot_held():
    pose, targets = np.asarray(ROBOT.nominal_pose), np.asarray(ROBOT.nominal_pose) + 0.3
    assert np.array_equal(held_before(pose + 0.1, targets, ROBOT), pose)
    assert np.array_equal(held_before(pose + 0.2, targets, ROBOT), targets)
    assert np.array_equal(held_before(pose, targets, replace(ROBOT, base="fixed")), targets)


def test_an_ideal_pd_at_the_stated_gains_follows_a_real_go2(shared_data: Path, tmp_path: Path):
    raw = shared_data / "go2" / "traj_3.csv.gz"
    if not raw.is_file() or not (shared_data / "robots" / "go2.xml").is_file():
        pytest.skip("no logs of a real Go2")
    for path in (shared_data / "robots" / "go2.xml", EXAMPLES / "go2.toml"):
        shutil.copy(path, tmp_path)
    robot = load_robot(str(tmp_path / "go2.toml"))
    log = with_posture(read_log(raw, robot, "go2_identification"), "hung")
    pd = nominal_pd(load_robot_fleet(robot, EXAMPLES / "go2_fleet.toml"), robot.num_joints)
    replayer = Replayer(log, robot, prepare(log, robot, "traj_3"))
    at_fleets, at_stated = (float(np.nanmean(replayer.run(each).rmse)) for each in (pd, at_stated_gains(pd, log)))
    assert at_stated < 0.021 < 0.04 < at_fleets
