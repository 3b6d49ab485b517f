"""Which posture a log is replayed in: the command line's before the log's own."""

from dataclasses import replace

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.pipeline.progress import SILENT
from motorprior.pipeline.replay.log_postures import PostureName, replayers_of
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT
from motorprior.transfer.posture import FALLEN_TILT

ROWS = 400


def still_log() -> MotorLog:
    """Some time in which one hip is told to move, and nothing does."""
    targets = np.tile(ROBOT.nominal_pose, (ROWS, 1))
    targets[:, 1] += np.linspace(0.0, 0.1, ROWS)
    return MotorLog(
        time=0.001 * np.arange(ROWS), position_target=targets, joint_pos=np.tile(ROBOT.nominal_pose, (ROWS, 1)),
        base_orientation=np.zeros((ROWS, 2)), joint_names=ROBOT.joint_names, robot=ROBOT.name, motor=ROBOT.motor,
        source="still",
    )  # fmt: skip


class Notes:
    """`Progress` that keeps what it is told."""

    def __init__(self):
        self.lines: list[str] = []
        self.start = SILENT.start

    def note(self, text: str) -> None:
        self.lines.append(text)


def test_what_is_asked_for_goes_before_what_the_log_states():
    fleet, notes = load_fleet("pupper_v2"), Notes()
    log = replace(still_log(), posture=np.full(ROWS, POSTURES.index("hung")))
    expected: dict[PostureName, str] = {"auto": "hung, as logged", "standing": "standing, as asked for"}
    for posture, said in expected.items():
        (replayer,) = replayers_of({"a": log}, {"a": log}, ROBOT, fleet, posture, notes).values()
        assert notes.lines.pop() == f"log a: {said}"
        assert replayer.prepared.posture is not None
        assert POSTURES[replayer.prepared.posture[0]] == said.split(",")[0]


def test_rows_left_out_after_a_fall_are_told():
    log = still_log()
    assert log.base_orientation is not None
    log.base_orientation[160:, 0] = FALLEN_TILT + 0.1
    notes = Notes()
    replayers_of({"a": log}, {"a": log}, ROBOT, load_fleet("pupper_v2"), "standing", notes)
    assert notes.lines == ["log a: standing, as asked for; 240 rows from a fall on are left out"]


def test_a_fixed_robot_has_one_posture():
    with pytest.raises(ConfigError, match="the base of 'pupper_v2' is fixed"):
        replayers_of({}, {}, replace(ROBOT, base="fixed"), load_fleet("pupper_v2"), "hung", Notes())
