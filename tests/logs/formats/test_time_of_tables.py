"""When rows were recorded: numbers, a known rate, or time stamps, which are read as seconds since the first row."""

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.exceptions import ArtifactError, LogError
from motorprior.logs.formats import csv_stream
from motorprior.logs.formats.column_map import load_column_map
from motorprior.logs.formats.registry import read_log
from motorprior.logs.motor_log import MotorLog

MAP = """
motor = "servo"
time = "when"
position_target = "goal_{joint}"
joint_pos = "pos_{joint}"
[joints.a]
"""
ROWS = 3000
SECONDS = np.cumsum(np.full(ROWS, 0.002)) - 0.002
START = datetime(2024, 3, 31, 0, 59, 57, 250_000)  # three seconds before clocks change in Europe
ANGLE = np.sin(SECONDS)


def stamps(zone: timezone | None = None) -> list[datetime]:
    return [START.replace(tzinfo=zone) + timedelta(milliseconds=2 * row) for row in range(ROWS)]


def read(path: Path, when: Any, text: str = MAP) -> MotorLog:
    (path.parent / "map.toml").write_text(text, "utf-8")
    if path.suffix == ".parquet":
        pq.write_table(pa.table({"when": when, "goal_a": ANGLE, "pos_a": ANGLE}), path)
    else:
        lines = [f"{cell},{angle!r},{angle!r}" for cell, angle in zip(when, ANGLE.tolist(), strict=True)]
        path.write_text("\n".join(["when,goal_a,pos_a", *lines]) + "\n", "utf-8")
    return read_log(path, columns=path.parent / "map.toml")


KINDS = {
    "local": pa.array(stamps(), pa.timestamp("us")),
    "zoned": pa.array(stamps(UTC), pa.timestamp("ns", "Europe/Berlin")),
    "milliseconds": pa.array(stamps(), pa.timestamp("ms")),
    "durations": pa.array([timedelta(days=400) + (each - START) for each in stamps()], pa.duration("us")),
    "texts": pa.array([each.isoformat() for each in stamps()]),
    "large texts": pa.array([each.isoformat() + "Z" for each in stamps()], pa.large_string()),
}


@pytest.mark.parametrize("kind", KINDS)
def test_time_stamps_of_parquet_are_seconds_since_the_first_row(tmp_path: Path, kind: str):
    log = read(tmp_path / "log.parquet", KINDS[kind])
    np.testing.assert_allclose(log.time, SECONDS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE)


@pytest.mark.parametrize("zone", [None, UTC, timezone(timedelta(hours=-3, minutes=-30))])
def test_time_stamps_of_a_table_of_text_are_seconds_since_the_first_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, zone: timezone | None
):
    monkeypatch.setattr(csv_stream, "_BLOCK", 20_000)  # several batches
    log = read(tmp_path / "log.csv", [each.isoformat(sep=" ") for each in stamps(zone)])
    np.testing.assert_allclose(log.time, SECONDS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE)


def test_a_zone_that_changes_is_no_step_in_time(tmp_path: Path):
    summer, winter = timezone(timedelta(hours=2)), timezone(timedelta(hours=1))
    some = [
        each.astimezone(winter if row < 1375 else summer).isoformat(timespec="microseconds")
        for row, each in enumerate(stamps(UTC))
    ]
    assert some[1374] > some[1000] and some[1375][11:13] != some[1374][11:13]
    np.testing.assert_allclose(read(tmp_path / "log.csv", some).time, SECONDS, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize(
    ("row", "cell", "said"),
    [
        (2500, "2024-03-31T01:00:02.25Z", "with a time zone; the first row is without"),
        (2500, "yesterday", "'yesterday', no time stamp"),
        (7, "", "row 7"),
        (0, "2024-03-31T00:59:57.25+01:00", "row 1, when is .*without a time zone; the first row is with"),
    ],
)
def test_a_row_whose_time_is_of_another_kind_is_named(tmp_path: Path, name: str, row: int, cell: str, said: str):
    some = [each.isoformat() for each in stamps()]
    some[row] = cell
    with pytest.raises(LogError, match=said) as refusal:
        read(tmp_path / name, some)
    assert str(refusal.value.where).endswith(name) and f"row {row or 1}" in refusal.value.problem


def test_a_missing_time_stamp_of_parquet_is_named(tmp_path: Path):
    some = [*stamps()[:9], None, *stamps()[10:]]
    with pytest.raises(LogError, match="row 9, when is empty"):
        read(tmp_path / "log.parquet", pa.array(some, pa.timestamp("us")))


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize("time", ["clock", "clock[0]"])
def test_a_missing_column_of_times_is_named(tmp_path: Path, name: str, time: str):
    with pytest.raises(LogError, match=r"no column 'clock'; it has 'when', 'goal_a', 'pos_a'"):
        read(tmp_path / name, SECONDS, MAP.replace('"when"', f'"{time}"'))


def test_stamps_that_run_backwards_are_refused(tmp_path: Path):
    some = stamps()
    some[4], some[5] = some[5], some[4]
    with pytest.raises(LogError, match="row 5, time runs backwards"):
        read(tmp_path / "log.csv", [each.isoformat() for each in some])


def test_a_unit_of_the_time_is_not_for_time_stamps(tmp_path: Path):
    with pytest.raises(LogError, match="when holds time stamps, which have a unit of their own"):
        read(tmp_path / "log.csv", [each.isoformat() for each in stamps()], MAP + '[units]\ntime = "ms"\n')


def test_a_word_of_a_dictionary_that_no_row_uses_harms_nothing(tmp_path: Path):
    words = pa.array(["never"] + [each.isoformat() for each in stamps()])
    coded = pa.DictionaryArray.from_arrays(pa.array(np.arange(1, ROWS + 1), pa.int32()), words)
    log = read(tmp_path / "log.parquet", coded)
    np.testing.assert_allclose(log.time, SECONDS, rtol=0, atol=1e-9)


def test_a_long_text_in_a_dictionary_is_no_time_stamp(tmp_path: Path):
    long = pa.DictionaryArray.from_arrays(pa.array(np.zeros(ROWS), pa.int32()), pa.array([60_000 * "x"]))
    with pytest.raises(LogError, match="row 0, when is 'xxx"):
        read(tmp_path / "log.parquet", long)


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
def test_a_known_rate_stands_for_the_time(tmp_path: Path, name: str):
    log = read(tmp_path / name, SECONDS.tolist(), MAP.replace('time = "when"', "rate = 500"))
    np.testing.assert_allclose(log.time, SECONDS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE)


@pytest.mark.parametrize(
    ("clock", "said"),
    [
        ("", "neither time, a column, nor rate"),
        ('time = "when"\nrate = 100', "both time and rate"),
        ("rate = 0", "rate = 0 is not a finite number from 0.001"),
        ('rate = "fast"', "rate = 'fast' is not a finite number"),
        ('rate = 100\nunits = {time = "ms"}', "units: time, and no column of times"),
    ],
)
def test_a_map_has_one_clock(tmp_path: Path, clock: str, said: str):
    (tmp_path / "map.toml").write_text(MAP.replace('time = "when"', clock), "utf-8")
    with pytest.raises(ArtifactError) as refusal:
        load_column_map(tmp_path / "map.toml")
    assert said in str(refusal.value)
