"""A gap ends a segment: the log doctor then finds none, no row changes, and pieces too short to use are counted."""

from collections.abc import Callable

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.gap_segments import begin_at_gaps
from motorprior.logs.motor_log import MotorLog, channels
from motorprior.logs.resampling import resample

Make = Callable[..., MotorLog]


def late(log: MotorLog, seconds: float, *rows: int) -> MotorLog:
    """The log with a pause before each of these rows."""
    for row in rows:
        log.time[row:] += seconds
    return log


def test_a_log_without_gaps_is_left_as_it_is(make_log: Make, full_log: MotorLog):
    for log in (make_log(), late(make_log(), 0.035, 100), full_log):
        assert begin_at_gaps(log, 0.002) == (log, "")


def test_a_segment_begins_after_every_gap_and_nothing_else_changes(make_log: Make):
    log = late(make_log(posture=np.repeat([1, 0], [80, 120])), 2.5, 60, 130)
    assert check_log(log).of("gaps")
    cut, told = begin_at_gaps(log, 0.002)
    assert [(part.start, part.stop) for part in cut.segment_slices()] == [(0, 60), (60, 130), (130, 200)]
    assert not check_log(cut).of("gaps")
    for name, values in channels(log).items():
        np.testing.assert_array_equal(getattr(cut, name), values)
    assert "2 gaps longer than 5 median steps: 2.51 s before row 60, at 3.35 s; 2.51 s before row 130" in told
    assert "left out" not in told


def test_segments_that_were_there_stay_apart(make_log: Make):
    log = late(make_log(segment=np.repeat([7, 3], 100)), 1.0, 150)
    cut, _ = begin_at_gaps(log, 0.002)
    assert cut.segment is not None and cut.segment.tolist() == [0] * 100 + [1] * 50 + [2] * 50


def test_a_grid_holds_nothing_of_the_gap(make_log: Make):
    log = late(make_log(), 2.5, 120)
    cut, _ = begin_at_gaps(log, 0.002)
    grid = resample(cut, 0.002)
    assert not np.any((grid.time > log.time[119]) & (grid.time < log.time[120]))
    assert resample(log, 0.002).num_rows > grid.num_rows + 1000, "without a segment it is full of lines"


def test_pieces_too_short_to_use_are_left_out_and_counted(make_log: Make):
    cut, told = begin_at_gaps(late(make_log(), 1.0, 100, 103, 107), 0.0)
    assert [part.stop - part.start for part in cut.segment_slices()] == [100, 4, 93]
    assert "3 rows between gaps, too few to use, are left out" in told
    shorter, told = begin_at_gaps(late(make_log(), 1.0, 100, 103, 107), 0.05)
    assert [part.stop - part.start for part in shorter.segment_slices()] == [100, 93]
    assert "7 rows between gaps" in told
    assert resample(shorter, 0.05).num_rows == 21 - 1 + 19


def test_a_segment_without_a_gap_is_not_left_out(make_log: Make):
    log = late(make_log(segment=np.repeat([0, 1, 2], [100, 3, 97])), 1.0, 50)
    assert [part.stop - part.start for part in begin_at_gaps(log)[0].segment_slices()] == [50, 50, 3, 97]


def test_a_slower_segment_has_no_gaps_for_that(make_log: Make):
    """100 rows at 0.01 s, then 100 at 0.1 s in a segment of their own, which lacks half a second more."""
    log = make_log(segment=np.repeat([0, 1], 100))
    log.time[100:] = log.time[99] + 0.1 * np.arange(1, 101)
    assert begin_at_gaps(log) == (log, "") and not check_log(log).of("gaps")
    log.time[150:] += 0.55
    cut, told = begin_at_gaps(log)
    assert [part.start for part in cut.segment_slices()] == [0, 100, 150] and cut.num_rows == log.num_rows
    (finding,) = check_log(log).of("gaps")
    assert "1 gap longer" in told and finding.row == 150 and finding.bound == pytest.approx(0.5)


def test_many_gaps_are_counted_and_the_first_named(make_log: Make):
    told = begin_at_gaps(late(make_log(), 1.0, *range(10, 200, 10)))[1]
    assert told.startswith("19 gaps longer than") and "and 14 more" in told and "before row 50," in told
    assert "before row 60," not in told


def test_rows_that_came_in_bursts_are_refused_with_a_remedy(make_log: Make):
    time = np.arange(200) * 1e-4 + 0.05 * (np.arange(200) // 3)
    with pytest.raises(LogError, match="nowhere 4 rows without a gap") as refusal:
        begin_at_gaps(make_log(time=time))
    assert refusal.value.remedy is not None and "rate" in refusal.value.remedy
