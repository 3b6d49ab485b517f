"""Windows lie inside segments; a missing channel is named in the error."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.exceptions import LogError
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import (
    INERTIA,
    MEANS,
    POS,
    SECONDS,
    TARGET,
    VEL,
    subsampled,
    training_data,
    used_seconds_text,
    with_window_that_fits,
)

# 10 rows per window
PRESET = replace(PRESETS["rollout"], taps=(0, 1, 4), warm_up=0, window=6, batch=50)
LENGTHS = (25, 9, 10, 40)


def a_log(lengths=LENGTHS, joints=2, **changes):
    rows = sum(lengths)
    rng = np.random.default_rng(0)
    series = (
        "position_target",
        "joint_pos",
        "joint_vel",
        "joint_torque",
        "external_torque",
        "load_inertia",
    )
    channels: dict[str, Any] = {name: rng.uniform(0.1, 1.0, (rows, joints)) for name in series}
    segment = np.repeat(np.arange(len(lengths)), lengths)

    return log_of(
        np.arange(rows) * 0.002,
        np.zeros((rows, joints)),
        **({"segment": segment} | channels | changes),
    )


def test_windows_are_all_rows_in_a_row_that_lie_inside_a_segment():
    log = a_log()
    data = training_data(log, PRESET, "log")
    assert log.segment is not None
    # ten rows, and the row after them, which the last step leads to
    inside = []
    for start in range(84 - 10):
        if len(set(log.segment[start : start + 11])) == 1:
            inside.append(start)

    assert data.starts.tolist() == inside
    assert len(inside) == 15 + 0 + 0 + 30  # length - 10 of each segment that is long enough

    regression = training_data(log, replace(PRESET, objective="torque"), "log")

    assert len(regression.starts) == 16 + 0 + 1 + 31


def test_a_rollout_uses_velocities_and_torques_at_the_middle_of_its_steps():
    # readings of an encoder on the rotor are used unchanged
    log = a_log(encoder="rotor")
    data = training_data(log, replace(PRESET, objective="rollout"), "log").series
    raw = training_data(log, replace(PRESET, objective="torque"), "log").series
    kept = [TARGET, POS, INERTIA, SECONDS]
    assert log.segment is not None
    assert set(range(7)) - set(MEANS) == set(kept)

    starts = np.flatnonzero(np.diff(log.segment, prepend=-1))
    inside = np.setdiff1d(np.arange(84), starts)

    np.testing.assert_array_equal(data[..., kept], raw[..., kept])
    # nothing is known before a segment
    np.testing.assert_array_equal(data[:, starts], raw[:, starts])

    middle = 0.5 * (raw[:, inside] + raw[:, inside - 1])

    np.testing.assert_allclose(
        data[:, inside][..., MEANS], middle[..., MEANS], rtol=1e-5, atol=1e-6
    )


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
    without: dict[str, Any] = {missing: None}
    preset = replace(PRESET, objective=objective)

    with pytest.raises(LogError, match=missing) as refusal:
        training_data(a_log(**without), preset, "my.parquet")

    assert refusal.value.where == "my.parquet"


@pytest.mark.parametrize(
    ("objective", "missing", "is_load"),
    [("rollout", "load_inertia", True), ("torque", "joint_torque", False)],
)
def test_only_the_error_of_a_missing_load_names_the_ways_to_get_loads(objective, missing, is_load):
    without: dict[str, Any] = {missing: None}
    preset = replace(PRESET, objective=objective)

    with pytest.raises(LogError) as refusal:
        training_data(a_log(**without), preset, "my.parquet")

    for way in ("`suspended`", "--fit-load"):
        assert (way in str(refusal.value.remedy)) is is_load


@pytest.mark.parametrize("lengths", [[6000], [200] * 30, [5000, 300, 700]])
def test_subsampled_windows_are_spread_over_the_log(lengths):
    data = training_data(a_log(lengths), PRESET, "x")
    subsample = subsampled(data, PRESET, 1000)

    rows = sum(segment.stop - segment.start for segment in subsample.segments)
    assert 900 <= rows <= 1000
    starts = [segment.start for segment in subsample.segments]
    assert starts[0] < 600
    assert starts[-1] > 5400 - 600
    assert max(np.diff(starts)) < 2 * 600
    for segment in subsample.segments:
        containing = [
            whole
            for whole in data.segments
            if whole.start <= segment.start < segment.stop <= whole.stop
        ]
        assert containing, segment
    assert subsampled(data, PRESET, 6000) is data


def test_the_pieces_that_move_most_are_taken():
    data = training_data(a_log([6000]), PRESET, "x")
    moves = np.arange(6000) % 600 >= 300
    series = data.series.copy()
    series[..., VEL] = np.where(moves, series[..., VEL], 0.0)

    subsample = subsampled(replace(data, series=series), PRESET, 1000)

    for segment in subsample.segments:
        assert moves[segment].mean() > 0.5, segment


@pytest.mark.parametrize(
    ("lengths", "longest", "min_used"),
    [
        ((500,) * 6, 449, 0.89),  # each segment is one window after the warm-up
        ((500,) * 6 + (2000,) * 2, 449, 0.85),
        ((900,) * 4, 424, 0.9),  # two windows in place of one and a remainder
        ((8000,) * 2, 500, 0.9),  # nothing to gain
    ],
)
def test_windows_are_as_long_as_the_segments_allow(lengths, longest: int, min_used: float):
    log = a_log(lengths)
    recipe = with_window_that_fits(PRESETS["long_runs"], log)

    assert recipe.window == longest

    text = used_seconds_text(training_data(log, recipe, "log"), recipe)
    used, total = (float(word) for word in text.split() if word[0].isdigit())

    assert used >= min_used * total


def test_segments_shorter_than_the_shortest_window_are_refused():
    log = a_log((100,) * 5)
    recipe = with_window_that_fits(PRESETS["long_runs"], log)

    with pytest.raises(LogError, match="longest segment has 100 rows"):
        training_data(log, recipe, "log")
