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
    KP,
    MEANS,
    POS,
    SECONDS,
    TARGET,
    TEMPERATURE_RISE,
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


def with_conditions(data, channel, values):
    """The data with one of ``values`` in each segment, in turn; motion grows with the value."""
    series = data.series.copy()
    for index, segment in enumerate(data.segments):
        value = values[index % len(values)]
        series[:, segment, channel] = value
        series[:, segment, VEL] *= value
    return replace(data, series=series)


def chosen_rows(data, channel) -> dict[float, int]:
    """Number of rows in the segments of the data by value of the channel."""
    rows: dict[float, int] = {}
    for segment in data.segments:
        value = float(data.series[0, segment.start, channel])
        rows[value] = rows.get(value, 0) + segment.stop - segment.start
    return rows


@pytest.mark.parametrize("channel", [KP, INERTIA, TEMPERATURE_RISE])
@pytest.mark.parametrize("rows", [2000, 6000])
def test_gains_loads_and_temperatures_give_equally_many_rows(channel, rows: int):
    values = (4.0, 20.0, 60.0)
    data = with_conditions(training_data(a_log([300] * 30), PRESET, "x"), channel, values)

    chosen = chosen_rows(subsampled(data, PRESET, rows), channel)

    assert sorted(chosen) == list(values)
    assert max(chosen.values()) <= 1.2 * min(chosen.values())
    assert 0.85 * rows <= sum(chosen.values()) <= rows


def test_a_rare_gain_keeps_all_of_its_rows():
    data = training_data(a_log([300] * 30), PRESET, "x")
    data = with_conditions(data, KP, (*[10.0] * 29, 1.0))

    assert chosen_rows(subsampled(data, PRESET, 3000), KP)[1.0] >= 290


def test_loads_that_are_recorded_at_every_gain_are_groups():
    data = training_data(a_log([3000] * 4), PRESET, "x")
    data = with_conditions(data, KP, (1.0, 1.0, 2.0, 2.0))
    data = with_conditions(data, INERTIA, (0.25, 2.0, 0.25, 2.0))

    rows = chosen_rows(subsampled(data, PRESET, 4000), INERTIA)

    assert rows[0.25] == pytest.approx(rows[2.0], rel=0.1)


def test_more_gains_than_pieces_are_spread_over_the_gains():
    gains = tuple(np.random.default_rng(0).permutation(40) + 1.0)
    data = with_conditions(training_data(a_log([300] * 40), PRESET, "x"), KP, gains)

    chosen = sorted(chosen_rows(subsampled(data, PRESET, 200), KP))

    assert len(chosen) >= 5
    assert chosen[0] <= 10.0
    assert max(np.diff(chosen)) <= 2 * 40 / len(chosen)


def test_loads_that_differ_in_every_segment_are_no_groups():
    data = training_data(a_log([300] * 30, joints=6), PRESET, "x")
    bench = data.series.copy()
    rng = np.random.default_rng(0)
    for segment in data.segments:
        bench[:, segment, INERTIA] = np.exp(rng.uniform(-9.0, -3.0, (6, 1)))

    with_loads = subsampled(replace(data, series=bench), PRESET, 2000)

    assert with_loads.segments == subsampled(data, PRESET, 2000).segments


@pytest.mark.parametrize(
    ("lengths", "rows"),
    [
        ([3000] * 20 + [5000], 60_000),
        ([3000] * 60 + [5000] * 2, 60_000),
        ([501] * 90 + [10_000] * 4, 60_000),
        ([2000] * 30 + [3000] * 30, 20_000),
    ],
)
def test_segments_that_are_shorter_than_a_piece_are_chosen_too(lengths, rows: int):
    log = a_log(lengths, joints=1)
    recipe = with_window_that_fits(PRESETS["long_runs"], log)
    data = training_data(log, recipe, "x")

    chosen = subsampled(data, recipe, rows).segments

    is_chosen = np.zeros(sum(lengths), dtype=bool)
    for segment in chosen:
        is_chosen[segment] = True
    assert 0.85 * rows <= is_chosen.sum() <= 1.15 * rows
    # of all parts of the log
    shares = [part.mean() for part in np.array_split(is_chosen, 4)]
    assert min(shares) >= 0.3 * max(shares)


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

    text = used_seconds_text(training_data(log, recipe, "log"), recipe, log)
    used, total = (float(word) for word in text.split() if word[0].isdigit())

    assert used >= min_used * total


def test_segments_shorter_than_the_shortest_window_are_refused():
    log = a_log((100,) * 5)
    recipe = with_window_that_fits(PRESETS["long_runs"], log)

    with pytest.raises(LogError, match="longest segment has 100 rows"):
        training_data(log, recipe, "log")


def test_the_used_seconds_are_those_of_the_whole_log_and_unused_runs_are_named():
    log = replace(a_log([3000] * 3 + [300], joints=1), source="a; b; c; d")
    recipe = with_window_that_fits(PRESETS["long_runs"], log)
    data = training_data(log, recipe, "log")
    moving = with_conditions(data, VEL, (3.0, 1.0, 2.0))

    text = used_seconds_text(subsampled(moving, recipe, 2500), recipe, log)

    used, total = (float(word) for word in text.split(";")[0].split() if word[0].isdigit())
    assert total == pytest.approx(0.002 * log.num_rows, abs=0.05)
    assert used < total * 2 / 3
    assert text.endswith("shorter than 1.08 s, not used: d; not chosen: b")


def test_runs_of_a_log_with_several_runs_are_named_by_number():
    log = a_log([3000, 100], joints=1)
    recipe = with_window_that_fits(PRESETS["long_runs"], log)

    assert "not used: segment 2" in used_seconds_text(training_data(log, recipe, "x"), recipe, log)
