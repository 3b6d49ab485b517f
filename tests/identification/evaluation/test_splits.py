"""Training and test rows never overlap; every joint of the test rows moves in the training rows."""

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.evaluation.splits import alternating_chunks, excited_in_any, split, window
from motorprior.logs.motor_log import MotorLog


def a_log(
    rows: int, start: float = 0.0, moving: tuple[int, ...] = (0,), segment: np.ndarray | None = None
) -> MotorLog:
    """Log of two joints at 500 Hz whose angles [rad] are the number of the row."""
    row = np.arange(float(rows))[:, None]
    pos = start + np.tile(row, (1, 2))
    target = np.zeros((rows, 2))
    target[:, list(moving)] = pos[:, list(moving)]
    return log_of(0.002 * np.arange(rows), target, pos, segment=segment)


def test_windows_are_equally_long_and_cover_a_motion_together():
    windows = [window(a_log(3000), 6.0, index, 3) for index in range(3)]
    assert [log.num_rows for log in windows] == [1000, 1000, 1000]
    assert [log.joint_pos[0, 0] for log in windows] == [0.0, 1000.0, 2000.0]


def test_every_second_log_is_a_test():
    halves = split({name: a_log(2000) for name in "abcde"}, 10.0, 100.0)
    assert list(halves.train) == ["a", "c", "e"]
    assert list(halves.test) == ["b", "d"]


@pytest.mark.parametrize(
    "logs", [{"a": a_log(2000)}, {"a": a_log(2000), "b": a_log(2000, 0.0, (1,))}]
)
def test_a_joint_that_moves_in_test_logs_only_makes_every_log_split_into_halves(
    logs: dict[str, MotorLog],
):
    halves = split(logs, 100.0, 100.0)

    assert list(halves.train) == list(halves.test) == list(logs)
    for name in logs:
        train = halves.train[name].joint_pos[:, 0]
        test = halves.test[name].joint_pos[:, 0]
        assert train.max() < test.min()
        assert len(train) + len(test) == 2000


def waves(*spans: tuple[float, float], seconds: float = 20.0) -> MotorLog:
    """A log at 100 Hz; each joint moves in one span of time [s]."""
    time = 0.01 * np.arange(round(100 * seconds))
    targets = []
    for start, end in spans:
        is_moving = (time >= start) & (time < end)
        targets.append(np.where(is_moving, np.sin(6 * time), 0.0))
    return log_of(time, np.stack(targets, axis=1))


def test_joints_that_move_one_after_the_other_move_in_training_and_test_rows():
    log = waves((0.0, 10.0), (10.0, 20.0), (20.0, 60.0), seconds=60.0)

    halves = split({"a": log}, 5.0, 5.0)
    assert excited_in_any(halves.train) == excited_in_any(halves.test) == [0, 1, 2]
    train_angles = set(halves.train["a"].joint_pos[:, 2])
    test_angles = set(halves.test["a"].joint_pos[:, 2])
    assert train_angles & test_angles <= {0.0}
    assert "alternating" in halves.rule


def rollouts(count: int) -> MotorLog:
    """Rollouts of 1 s of two moving joints, each a segment of a log at 100 Hz."""
    log = waves((0.0, 1.0 * count), (0.0, 1.0 * count), seconds=1.0 * count)
    return log_of(
        log.time, log.position_target, log.joint_pos, segment=np.arange(log.num_rows) // 100
    )


def test_short_rollouts_are_split_by_whole_rollouts():
    train, test = alternating_chunks(rollouts(20), 8.0)

    assert [log.num_rows for log in (*train.segments(), *test.segments())] == [100] * 16
    times = {*train.time[::100].round(2), *test.time[::100].round(2)}
    assert len(times) == 16  # of 16 rollouts


def test_rollouts_are_split_into_halves():
    halves = split({"a": rollouts(20)}, 100.0, 100.0)

    assert "half" in halves.rule
    assert halves.train["a"].num_rows + halves.test["a"].num_rows >= 1900
