"""The posture of a log is the logged one, or that with the lower replay error; falls are not compared."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.logs.motor_log import POSTURES
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.studies.log_replay import Replayer, prepare
from motorprior.studies.posture import FALLEN_TILT, find_posture, with_posture

CODE = {name: code for code, name in enumerate(POSTURES)}


@pytest.mark.parametrize("suspended", [True, False])
def test_replays_distinguish_a_suspended_robot_from_a_standing_one(record_log, fleet, suspended: bool):
    log = record_log(fleet.sample(ROBOT.num_joints, 3).actuator(), suspended)
    found = find_posture(log, prepare(log, ROBOT, "log"), ROBOT, fleet.center(ROBOT.num_joints).actuator())
    assert found.name == ("suspended" if suspended else "standing")
    assert "mrad standing" in found.evidence and "mrad suspended" in found.evidence


def test_a_logged_posture_is_used_and_the_true_motors_replay_the_log_exactly(record_log, fleet):
    motors = fleet.center(ROBOT.num_joints).actuator()
    log = with_posture(record_log(motors, suspended=True), "suspended")
    assert find_posture(log, log, ROBOT, motors).evidence == "suspended, as logged"
    error = {name: np.nanmax(Replayer(both, ROBOT, both).run(motors).rmse) for name in ("suspended", "standing")
             for both in [with_posture(log, name)]}  # fmt: skip
    assert error["suspended"] < 1e-3 < 10e-3 < error["standing"]


def test_rows_after_a_fall_are_not_compared(record_log, fleet):
    motors = fleet.center(ROBOT.num_joints).actuator()
    log = record_log(motors, suspended=False)
    tilt, spoiled = np.zeros((log.num_rows, 2)), log.joint_pos.copy()
    tilt[400:550, 0], spoiled[400:] = FALLEN_TILT + 0.1, 1.0
    tilt[100:110, 1] = -1.5  # a wrong reading is no fall
    fallen = with_posture(replace(log, base_orientation=tilt, joint_pos=spoiled), "standing")
    assert (
        fallen.posture is not None
        and set(fallen.posture[400:550]) == {CODE["fallen"]}
        and set(fallen.posture[:400]) == {CODE["standing"]}
    )
    replayer = Replayer(fallen, ROBOT, fallen)
    assert replayer.compared[:400].all() and not replayer.compared[400:].any()
    assert np.nanmax(replayer.run(motors).rmse) < 0.02 < 1.0, "spoiled rows would dominate"
