"""Resampling holds commands and interpolates angles; gaps begin segments; repeats are dropped."""

import numpy as np
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import channels
from motorprior.logs.operations import drop_repeats, repeated_rows, resample, split_at_gaps


@pytest.mark.parametrize("period", [0.002, 1 / 3000])
def test_resampling_holds_the_command_and_interpolates_the_angle(make_log, period):
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(2e-3, 2e-2, 100))
    line = 2.0 * time[:, None] + np.array([0.0, 1.0])
    step = np.repeat(np.arange(100.0)[:, None], 2, axis=1)
    log = resample(make_log(rows=100, time=time, joint_pos=line, position_target=step), period)

    np.testing.assert_allclose(np.diff(log.time), period, rtol=1e-9)
    np.testing.assert_allclose(log.joint_pos[:, 0], 2.0 * log.time, atol=1e-12)

    # the mean of the commands in force until the next row, so that none acts late
    fine = np.arange(20) / 20 * period
    command_in_force = np.searchsorted(time, log.time[:-1, None] + fine, side="right") - 1
    mean_command = command_in_force.mean(axis=1)

    np.testing.assert_allclose(log.position_target[:-1, 0], mean_command, atol=0.06)

    # where one command holds for the whole period, it is kept exactly
    command_at_end = np.searchsorted(time, log.time[:-1] + period, side="right") - 1
    is_constant = command_in_force[:, 0] == command_at_end

    np.testing.assert_array_equal(log.position_target[:-1][is_constant, 0] % 1.0, 0.0)


def test_resampling_does_not_mix_segments(full_log):
    log = resample(full_log, 0.001)
    for old, new in zip(full_log.segments(), log.segments(), strict=True):
        assert new.time[0] == old.time[0]
        assert old.time[-1] - 0.001 <= new.time[-1] <= old.time[-1]


def with_pauses(log, seconds, *rows):
    """The log with a pause of ``seconds`` before each of these rows."""
    for row in rows:
        log.time[row:] += seconds
    return log


def test_a_segment_begins_after_every_gap_and_nothing_else_changes(make_log):
    log = with_pauses(make_log(posture=np.repeat([1, 0], [80, 120])), 2.5, 60, 130)
    cut, note = split_at_gaps(log, 0.002)
    slices = [(rows.start, rows.stop) for rows in cut.segment_slices()]

    assert slices == [(0, 60), (60, 130), (130, 200)]
    for name, values in channels(log).items():
        np.testing.assert_array_equal(getattr(cut, name), values)
    assert "2.51 s before row 60, at 3.35 s, 2.51 s before row 130" in note


def test_segments_that_are_too_short_are_left_out_and_counted(make_log):
    cut, note = split_at_gaps(with_pauses(make_log(), 1.0, 100, 103, 107), 0.0)

    assert [rows.stop - rows.start for rows in cut.segment_slices()] == [100, 4, 93]
    assert "3 rows" in note

    shorter, _ = split_at_gaps(with_pauses(make_log(), 1.0, 100, 103, 107), 0.05)

    assert [rows.stop - rows.start for rows in shorter.segment_slices()] == [100, 93]
    assert resample(shorter, 0.05).num_rows == 21 - 1 + 19

    # three rows at 10 kHz every 50 ms
    bursts = np.arange(200) * 1e-4 + 0.05 * (np.arange(200) // 3)

    with pytest.raises(LogError, match="rate"):
        split_at_gaps(make_log(time=bursts))


def test_dropping_repeats_restores_the_log_that_was_polled(make_log):
    log = make_log()
    polled = np.sort(np.concatenate([np.arange(200), np.arange(0, 200, 3)]))
    repeats = np.append(False, np.diff(polled) == 0)
    faster = log.rows(polled)
    faster.time[repeats] += 1e-3

    assert repeated_rows(faster).sum() == repeats.sum() == 67
    for name, values in channels(log).items():
        np.testing.assert_array_equal(getattr(drop_repeats(faster), name), values)
