"""What is fitted to and what is judged never overlap, and every joint that is judged was seen to move."""

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.validation.log_stretches import (
    MOST_LOGS,
    SHORTEST,
    long_segments,
    moving_joints,
    split,
    stretches,
    with_joints,
)


def a_log(rows: int, start: float = 0.0, moving: tuple[int, ...] = (0,), segment: np.ndarray | None = None) -> MotorLog:
    """Two joints at 500 Hz whose angles tell the row."""
    pos = start + np.tile(np.arange(float(rows))[:, None], (1, 2))
    target = np.zeros((rows, 2))
    target[:, list(moving)] = pos[:, list(moving)]
    return MotorLog(
        time=0.002 * np.arange(rows), position_target=target, joint_pos=pos, joint_names=("hip", "knee"), robot="r",
        motor="m", source=f"{start}", segment=segment,
    )  # fmt: skip


def test_stretches_are_as_long_as_each_other_and_cover_a_motion_together():
    found = stretches([a_log(3000, 0.0), a_log(3000, 1e4), a_log(3000, 2e4)], 6.0)
    assert [part.stop - part.start for part in found.segment_slices()] == [1000, 1000, 1000]
    assert [found.joint_pos[part.start, 0] for part in found.segment_slices()] == [0.0, 1e4 + 1000, 2e4 + 2000]
    assert stretches([a_log(500, 0.0)], 6.0).num_rows == 500


def test_every_second_log_is_judged():
    found = split({name: a_log(2000) for name in "abcde"}, 10.0, 100.0)
    assert list(found.known) == ["a", "c", "e"] and list(found.judged) == ["b", "d"]


@pytest.mark.parametrize("logs", [{"a": a_log(2000)}, {"a": a_log(2000), "b": a_log(2000, 0.0, (1,))}])
def test_halves_where_a_judged_joint_would_never_have_moved(logs: dict[str, MotorLog]):
    found = split(logs, 100.0, 100.0)
    assert list(found.known) == list(found.judged) == list(logs)
    for name in logs:
        known, judged = found.known[name].joint_pos[:, 0], found.judged[name].joint_pos[:, 0]
        assert known.max() < judged.min() and len(known) + len(judged) == 2000


def waves(*spans: tuple[float, float], seconds: float = 20.0) -> MotorLog:
    """A log at 100 Hz whose joints move in a span of time each [s]."""
    time = 0.01 * np.arange(round(100 * seconds))
    target = np.stack([np.where((time >= a) & (time < b), np.sin(6 * time), 0.0) for a, b in spans], axis=1)
    names = ("hip", "knee", "toe")[: len(spans)]
    return MotorLog(
        time=time, position_target=target, joint_pos=target, joint_names=names, robot="r", motor="m", source="waves"
    )


def test_joints_that_move_one_after_the_other_are_known_and_judged():
    found = split({"a": waves((0.0, 10.0), (10.0, 20.0), (20.0, 60.0), seconds=60.0)}, 5.0, 5.0)
    assert moving_joints(found.known) == moving_joints(found.judged) == [0, 1, 2]
    assert not set(found.known["a"].joint_pos[:, 2]) & set(found.judged["a"].joint_pos[:, 2]) - {0.0}
    assert "in turns" in found.told


def test_joints_that_move_in_one_piece_each_are_named():
    with pytest.raises(LogError, match=r"hip moves from 0\.0 to 1\.\d s of a; knee moves from 1\.6 to"):
        split({"a": waves((0.0, 1.6), (1.6, 3.2), seconds=3.2)}, 5.0, 5.0)


@pytest.mark.parametrize("spans", [[(100.0, 120.0)], [(40.0, 50.0), (100.0, 120.0)]])
def test_what_stands_still_is_not_known(spans: list[tuple[float, float]]):
    found = split({"a": waves(*spans, seconds=130.0)}, 5.0, 5.0)
    assert moving_joints(found.known) == moving_joints(found.judged) != []


def test_a_short_motion_in_a_long_log_is_cut_in_two():
    found = split({"a": waves((4.0, 6.0), seconds=10.0)}, 9.0, 9.0)
    assert moving_joints(found.known) == moving_joints(found.judged) == [0]


def test_of_many_logs_some_from_all_over_the_list():
    names = [f"{index:02d}" for index in range(40)]
    found = split({name: a_log(2000) for name in names}, 10.0, 10.0)
    taken = sorted([*found.known, *found.judged])
    assert len(taken) == MOST_LOGS and taken[0] == "00" and taken[-1] == "39"
    assert f"{MOST_LOGS} of 40 logs" in found.told


def test_no_more_seconds_than_asked_for():
    found = split({name: a_log(5000) for name in "abcd"}, 4.0, 8.0)
    assert [log.num_rows for log in found.known.values()] == [1000, 1000]
    assert [log.num_rows for log in found.judged.values()] == [2000, 2000]


def test_segments_that_are_too_short_are_left_out():
    least = round(SHORTEST / 0.002) + 1
    log = a_log(2 * least + 1, segment=np.repeat([0, 1, 2], [least, 1, least]))
    kept = long_segments(log)
    assert kept is not None and kept.num_rows == 2 * least
    assert long_segments(a_log(least - 1)) is None
    with pytest.raises(LogError, match=f"no segment of {SHORTEST:g} s"):
        split({"a": a_log(least - 1), "b": a_log(least - 1)}, 10.0, 10.0)


def test_a_log_of_some_joints_has_their_columns():
    log = a_log(10, moving=(1,))
    assert moving_joints({"a": log}) == [1]
    found = with_joints(log, [1])
    assert found.joint_names == ("knee",)
    np.testing.assert_array_equal(found.position_target[:, 0], log.position_target[:, 1])
