"""A gap ends a segment: the log doctor then finds none, no row changes, and pieces too short to use are counted."""

from collections.abc import Callable

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog, channels
from motorprior.logs.operations import begin_at_gaps, resample

Make = Callable[..., MotorLog]


def late(log: MotorLog, seconds: float, *rows: int) -> MotorLog:
    """The log with a pause before each of these rows."""
    for row in rows:
        log.time[row:] += seconds
    return log


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


def test_pieces_too_short_to_use_are_left_out_and_counted(make_log: Make):
    cut, told = begin_at_gaps(late(make_log(), 1.0, 100, 103, 107), 0.0)
    assert [part.stop - part.start for part in cut.segment_slices()] == [100, 4, 93]
    assert "3 rows between gaps, too few to use, are left out" in told
    shorter, told = begin_at_gaps(late(make_log(), 1.0, 100, 103, 107), 0.05)
    assert [part.stop - part.start for part in shorter.segment_slices()] == [100, 93]
    assert "7 rows between gaps" in told
    assert resample(shorter, 0.05).num_rows == 21 - 1 + 19


def test_rows_that_came_in_bursts_are_refused_with_a_remedy(make_log: Make):
    time = np.arange(200) * 1e-4 + 0.05 * (np.arange(200) // 3)
    with pytest.raises(LogError, match="no run of 4 rows without a gap") as refusal:
        begin_at_gaps(make_log(time=time))
    assert refusal.value.remedy is not None and "rate" in refusal.value.remedy
