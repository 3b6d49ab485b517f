"""Training and test rows never overlap; every joint of the test rows moves in the training rows."""

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.evaluation.splits import excited_in_any, split, window
from motorprior.logs.motor_log import MotorLog


def a_log(
    rows: int, start: float = 0.0, moving: tuple[int, ...] = (0,), segment: np.ndarray | None = None
) -> MotorLog:
    """Two joints at 500 Hz whose angles are the row."""
    pos = start + np.tile(np.arange(float(rows))[:, None], (1, 2))
    target = np.zeros((rows, 2))
    target[:, list(moving)] = pos[:, list(moving)]
    return log_of(0.002 * np.arange(rows), target, pos, segment=segment)


def test_windows_are_equally_long_and_cover_a_motion_together():
    found = [window(a_log(3000), 6.0, index, 3) for index in range(3)]
    assert [(log.num_rows, log.joint_pos[0, 0]) for log in found] == [
        (1000, 0.0),
        (1000, 1000.0),
        (1000, 2000.0),
    ]


def test_every_second_log_is_a_test():
    found = split({name: a_log(2000) for name in "abcde"}, 10.0, 100.0)
    assert list(found.train) == ["a", "c", "e"] and list(found.test) == ["b", "d"]


@pytest.mark.parametrize(
    "logs", [{"a": a_log(2000)}, {"a": a_log(2000), "b": a_log(2000, 0.0, (1,))}]
)
def test_halves_where_a_joint_moves_in_the_test_logs_only(logs: dict[str, MotorLog]):
    found = split(logs, 100.0, 100.0)
    assert list(found.train) == list(found.test) == list(logs)
    for name in logs:
        train = found.train[name].joint_pos[:, 0]
        test = found.test[name].joint_pos[:, 0]
        assert train.max() < test.min() and len(train) + len(test) == 2000


def waves(*spans: tuple[float, float], seconds: float = 20.0) -> MotorLog:
    """A log at 100 Hz whose joints move in a span of time each [s]."""
    time = 0.01 * np.arange(round(100 * seconds))
    target = np.stack(
        [np.where((time >= a) & (time < b), np.sin(6 * time), 0.0) for a, b in spans], axis=1
    )
    return log_of(time, target)


def test_joints_that_move_one_after_the_other_are_in_both_parts():
    found = split({"a": waves((0.0, 10.0), (10.0, 20.0), (20.0, 60.0), seconds=60.0)}, 5.0, 5.0)
    assert excited_in_any(found.train) == excited_in_any(found.test) == [0, 1, 2]
    assert not set(found.train["a"].joint_pos[:, 2]) & set(found.test["a"].joint_pos[:, 2]) - {0.0}
    assert "alternating" in found.rule
