"""The posture of a replay: an option overrides the log."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.studies.posture import FALLEN_TILT, PostureName, replayers_of

ROWS = 400


def still_log() -> MotorLog:
    """One hip is commanded to move, and nothing does."""
    targets = np.tile(ROBOT.nominal_pose, (ROWS, 1))
    targets[:, 1] += np.linspace(0.0, 0.1, ROWS)
    return MotorLog(
        time=0.001 * np.arange(ROWS), position_target=targets, joint_pos=np.tile(ROBOT.nominal_pose, (ROWS, 1)),
        base_orientation=np.zeros((ROWS, 2)), joint_names=ROBOT.joint_names, robot=ROBOT.name, motor=ROBOT.motor,
        source="still",
    )  # fmt: skip


@pytest.mark.parametrize(("posture", "used"), [("auto", "suspended"), ("standing", "standing")])
def test_an_option_overrides_the_posture_in_the_log(posture: PostureName, used: str):
    fleet, log = load_fleet("pupper_v2"), replace(still_log(), posture=np.full(ROWS, POSTURES.index("suspended")))
    (replayer,) = replayers_of({"a": log}, {"a": log}, ROBOT, fleet, posture, lambda text: None).values()
    assert replayer.prepared.posture is not None and POSTURES[replayer.prepared.posture[0]] == used


def test_rows_after_a_fall_are_excluded():
    log, notes = still_log(), []
    assert log.base_orientation is not None
    log.base_orientation[160:, 0] = FALLEN_TILT + 0.1
    (replayer,) = replayers_of(
        {"a": log}, {"a": log}, ROBOT, load_fleet("pupper_v2"), "standing", notes.append
    ).values()
    assert (~replayer.compared).sum() == 240 and "240 rows" in notes[0]


def test_a_fixed_robot_has_one_posture():
    with pytest.raises(ConfigError, match="the base of 'pupper_v2' is fixed"):
        replayers_of({}, {}, replace(ROBOT, base="fixed"), load_fleet("pupper_v2"), "suspended", lambda text: None)
