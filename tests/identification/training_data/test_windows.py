"""Windows are drawn from whole segments, and what cannot be trained on is refused by name."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from motorprior.exceptions import ConfigError, LogError
from motorprior.identification.presets import PRESETS, identification_preset
from motorprior.identification.training_data.windows import (
    INERTIA,
    MEANS,
    PAUSE,
    POS,
    SECONDS,
    TARGET,
    VEL,
    draw,
    some_stretches,
    that_fits,
    training_data,
)
from motorprior.logs.motor_log import MotorLog

PRESET = replace(PRESETS["rollout"], taps=(0, 1, 4), warm_up=0, window=6, batch=50)  # 10 rows per window
LENGTHS = (25, 9, 10, 40)


def a_log(lengths=LENGTHS, joints=2, **changes):
    rows, rng = sum(lengths), np.random.default_rng(0)
    series = ("position_target", "joint_pos", "joint_vel", "joint_torque", "external_torque", "load_inertia")
    channels: dict[str, Any] = {name: rng.uniform(0.1, 1.0, (rows, joints)) for name in series}
    log = MotorLog(
        time=np.arange(rows) * 0.002,
        segment=np.repeat(np.arange(len(lengths)), lengths),
        joint_names=tuple("abcdef"[:joints]),
        robot="bench",
        motor="m",
        source="test",
        **channels,
    )
    return replace(log, **changes)


def test_no_window_crosses_a_segment_and_none_is_left_out():
    log = a_log()
    data = training_data(log, PRESET, "log")
    assert log.segment is not None
    # ten rows, and the one that the last of them leads to
    inside = [start for start in range(84 - 10) if len(set(log.segment[start : start + 11])) == 1]
    assert data.starts.tolist() == inside
    assert len(inside) == 15 + 0 + 0 + 30  # length - 10 of each segment that is long enough
    regression = training_data(log, replace(PRESET, objective="torque"), "log")
    assert len(regression.starts) == 16 + 0 + 1 + 31


def test_drawn_rows_are_windows_of_all_motors():
    data = training_data(a_log(), PRESET, "log")
    motors, starts = draw(np.random.default_rng(0), data, PRESET, 40)
    assert motors.shape == starts.shape == (40, 50)
    assert set(motors.ravel()) == {0, 1} and set(starts.ravel()) == set(data.starts)


def test_series_are_the_channels_in_order():
    log = a_log()
    data = training_data(log, replace(PRESET, objective="torque"), "log")
    columns = (
        log.position_target, log.joint_pos, log.joint_vel, log.joint_torque, log.external_torque, log.load_inertia,
    )  # fmt: skip
    for index, column in enumerate(columns):
        assert column is not None
        np.testing.assert_array_equal(data.series[..., index], column.T.astype(np.float32))
    np.testing.assert_allclose(data.series[..., SECONDS], np.tile(0.002 * np.arange(84), (2, 1)), rtol=1e-6)


def test_a_log_that_began_long_ago_has_a_cold_start_all_the_same():
    # what warms, warms from the log's first row on
    late = replace(a_log(), time=1e5 + np.arange(84) * 0.002)
    found = training_data(late, replace(PRESET, objective="torque"), "log").series[:, :, SECONDS]
    np.testing.assert_allclose(found, np.tile(0.002 * np.arange(84), (2, 1)), atol=1e-6)


def test_a_rollout_of_joints_begins_in_states_without_the_noise_of_readings_and_torque_regression_sees_them_raw():
    rng, time = np.random.default_rng(0), np.arange(600) * 0.002
    wave = np.tile(0.4 * np.sin(9.0 * time)[:, None], (1, 2))
    noisy = wave + 0.001 * rng.standard_normal(wave.shape)
    log = a_log((300, 300), joint_pos=noisy, joint_vel=np.gradient(noisy, 0.002, axis=0))
    data, raw = (training_data(log, replace(PRESET, objective=name), "log").series for name in ("rollout", "torque"))
    middle = 3.6 * np.cos(9.0 * (time - 0.001))
    inside = np.setdiff1d(np.arange(600), [0, 300])
    for index, truth in ((POS, wave[:, 0]), (VEL, middle)):
        left, before = (np.std((each[..., index] - truth)[:, inside]) for each in (data, raw))
        assert left < 0.5 * before
    np.testing.assert_array_equal(raw[..., POS], noisy.T.astype(np.float32))
    rotor = training_data(replace(log, encoder="rotor"), PRESET, "log").series
    np.testing.assert_array_equal(rotor[..., POS], noisy.T.astype(np.float32))


def test_a_rollout_gets_velocities_and_torques_of_the_middle_of_its_steps():
    log = a_log(encoder="rotor")  # whose readings are taken as they are
    data, raw = (training_data(log, replace(PRESET, objective=name), "log").series for name in ("rollout", "torque"))
    kept = [TARGET, POS, INERTIA, SECONDS]
    assert log.segment is not None and set(range(7)) - set(MEANS) == set(kept)
    starts = np.flatnonzero(np.diff(log.segment, prepend=-1))
    inside = np.setdiff1d(np.arange(84), starts)
    np.testing.assert_array_equal(data[..., kept], raw[..., kept])
    np.testing.assert_array_equal(data[:, starts], raw[:, starts])  # nothing is known before a segment
    middle = 0.5 * (raw[:, inside] + raw[:, inside - 1])
    np.testing.assert_allclose(data[:, inside][..., MEANS], middle[..., MEANS], rtol=1e-5, atol=1e-6)


def test_scales_are_the_spread_of_the_log():
    log = a_log(encoder="rotor")
    data = training_data(log, PRESET, "log")
    assert data.scales["error_scale"] == pytest.approx(np.std(log.position_target - log.joint_pos))
    assert log.joint_vel is not None and log.joint_torque is not None
    assert data.scales["velocity_scale"] == pytest.approx(np.std(log.joint_vel))
    assert data.scales["torque_scale"] == pytest.approx(np.std(log.joint_torque))
    assert np.max(log.joint_torque) < data.scales["torque_limit"] <= 1.2 * np.max(log.joint_torque)


@pytest.mark.parametrize(("warm_up", "rows"), [(0, 11), (3, 11), (4, 11), (5, 12), (18, 25)])
def test_a_window_begins_with_the_history_or_the_warm_up_whichever_is_longer(warm_up, rows):
    data = training_data(a_log(), replace(PRESET, warm_up=warm_up), "log")
    assert len(data.starts) == sum(max(0, length - rows + 1) for length in LENGTHS)


def test_a_rollout_needs_no_torque_and_says_whether_it_has_one():
    data = training_data(a_log(joint_torque=None), PRESET, "log")
    assert np.all(data.series[..., 3] == 0.0) and not data.measured.torque
    assert training_data(a_log(), PRESET, "log").measured.torque


def test_a_rollout_finds_the_velocities_of_a_log_of_positions_within_each_segment():
    times, log = np.concatenate([0.002 * np.arange(length) for length in LENGTHS]), a_log()
    wave = 0.3 * np.sin(9.0 * times)[:, None] * np.ones((1, 2))
    speed = 2.7 * np.cos(9.0 * times)[:, None] * np.ones((1, 2))
    known, found = (
        training_data(replace(log, joint_pos=wave, joint_vel=given, joint_torque=None), PRESET, "log")
        for given in (speed, None)
    )
    assert found.scales["velocity_scale"] == pytest.approx(known.scales["velocity_scale"], rel=1e-3)
    np.testing.assert_allclose(found.series, known.series, atol=2e-3)  # of 2.7 rad/s


@pytest.mark.parametrize(
    ("objective", "missing"),
    [
        ("rollout", "load_inertia"),
        ("rollout", "external_torque"),
        ("torque", "joint_vel"),
        ("torque", "joint_torque"),
    ],
)
def test_a_missing_channel_is_named(objective, missing):
    gone: dict[str, Any] = {missing: None}
    with pytest.raises(LogError, match=f"my.parquet: no {missing}") as refusal:
        training_data(a_log(**gone), replace(PRESET, objective=objective), "my.parquet")
    assert all(way in str(refusal.value.remedy) for way in ("`hung`", "`fit_load`")) == (objective == "rollout")


def test_a_log_of_another_period_is_refused_with_both():
    with pytest.raises(LogError, match=r"0\.002 s, the preset's is 0\.01 s -> import .* period 0\.01; record that"):
        training_data(a_log(), replace(PRESET, period=0.01), "log")


def test_segments_shorter_than_a_window_are_refused_with_its_length():
    with pytest.raises(LogError, match="longest segment has 9 rows, a window 11"):
        training_data(a_log(lengths=(9, 9)), PRESET, "log")


@pytest.mark.parametrize(("longest", "window"), [(900, 500), (300, 295), (40, 64)])
def test_windows_are_no_longer_than_the_longest_segment_allows_and_never_very_short(longest: int, window: int):
    long_runs = replace(PRESET, window=500)  # four rows of history, and one that the last row leads to
    assert that_fits(long_runs, a_log(lengths=(20, longest))).window == window
    assert that_fits(replace(PRESET, objective="torque"), a_log(lengths=(3,))).window == PRESET.window


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match=r"rollout.*one_network"):
        identification_preset("papper")


def test_work_begins_anew_after_a_pause_and_where_the_clock_does():
    log = a_log()
    parts = log.segment_slices()
    time = log.time.copy()
    time[parts[1]] += PAUSE - 1.0  # a short pause: still warm
    time[parts[2]] += 3 * PAUSE
    time[parts[3]] -= 100.0
    seconds = training_data(replace(log, time=time), PRESET, "log").series[0, :, SECONDS]
    for part, start in zip(parts, (0.0, LENGTHS[0] * 0.002 + PAUSE - 1.0, 0.0, 0.0), strict=True):
        np.testing.assert_allclose(seconds[part], start + 0.002 * np.arange(part.stop - part.start), atol=1e-4)


@pytest.mark.parametrize("lengths", [[6000], [200] * 30, [5000, 300, 700]])
def test_stretches_are_from_all_over_the_log_and_about_as_long_as_asked_for(lengths):
    data = training_data(a_log(lengths), PRESET, "x")
    some = some_stretches(data, PRESET, 1000)
    assert 900 <= sum(part.stop - part.start for part in some.parts) <= 1000
    assert some.parts[0].start == 0 and some.parts[-1].stop > 5900
    assert all(any(whole.start <= part.start < part.stop <= whole.stop for whole in data.parts) for part in some.parts)
    assert some_stretches(data, PRESET, 6000) is data


def test_stretches_of_parts_that_are_shorter_than_two_windows_are_these_parts():
    data = training_data(a_log([12] * 20), PRESET, "x")
    some = some_stretches(data, replace(PRESET, window=60), 100)
    assert 2 <= len(some.parts) <= 8 and all(part in data.parts for part in some.parts)
