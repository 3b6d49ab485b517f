"""Times of rows: numbers, a known rate, or time stamps, read as seconds since the first row."""

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from motor_logs import TABLE_MAP

from motorprior.exceptions import LogError
from motorprior.logs.read_log import read_log

MAP = f"{TABLE_MAP}[joints.a]\n"
SECONDS = 0.002 * np.arange(300)
START = datetime(2024, 3, 31, 0, 59, 57, 250_000)  # three seconds before clocks change in Europe


def stamps(zone: timezone | None = None) -> list[datetime]:
    start = START.replace(tzinfo=zone)
    return [start + timedelta(milliseconds=2 * row) for row in range(len(SECONDS))]


def times(path: Path, cells: Any, text: str = MAP) -> np.ndarray:
    """Times [s] of a log whose column of time has these cells."""
    columns = path.parent / "map.toml"
    columns.write_text(text, "utf-8")

    if path.suffix == ".parquet":
        pq.write_table(pa.table({"t": cells, "goal_a": SECONDS, "pos_a": SECONDS}), path)
    else:
        rows = "".join(f"{cell},{1e-3 * row:.4f},0.2\n" for row, cell in enumerate(cells))
        path.write_text(f"t,goal_a,pos_a\n{rows}", "utf-8")

    return read_log(path, columns=columns).time


DURATIONS = [timedelta(days=400) + (stamp - START) for stamp in stamps()]
STAMPS = {
    "local": pa.array(stamps(), pa.timestamp("us")),
    "zoned": pa.array(stamps(UTC), pa.timestamp("ns", "Europe/Berlin")),
    "durations": pa.array(DURATIONS, pa.duration("us")),
    "texts": pa.array([stamp.isoformat() + "Z" for stamp in stamps()], pa.large_string()),
}


@pytest.mark.parametrize("name", STAMPS)
def test_time_stamps_of_parquet_are_seconds_since_the_first_row(tmp_path: Path, name: str):
    time = times(tmp_path / "log.parquet", STAMPS[name])

    np.testing.assert_allclose(time, SECONDS, rtol=0, atol=1e-9)


@pytest.mark.parametrize("zone", [None, UTC, timezone(timedelta(hours=-3, minutes=-30))])
def test_time_stamps_of_csv_are_seconds_since_the_first_row(tmp_path: Path, zone: timezone | None):
    cells = [stamp.isoformat(sep=" ") for stamp in stamps(zone)]
    np.testing.assert_allclose(times(tmp_path / "log.csv", cells), SECONDS, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize(("row", "cell"), [(250, "2024-03-31T01:00:02.25Z"), (7, "")])
def test_a_bad_time_stamp_is_named(tmp_path: Path, name: str, row: int, cell: str):
    cells = [stamp.isoformat() for stamp in stamps()]
    cells[row] = cell

    with pytest.raises(LogError, match=f"{name}: row {row}, t .*{cell}"):
        times(tmp_path / name, cells)


def test_a_known_rate_replaces_the_column_of_time(tmp_path: Path):
    with_rate = MAP.replace('time = "t"', "rate = 500")  # [Hz]

    time = times(tmp_path / "log.csv", SECONDS.tolist(), with_rate)

    np.testing.assert_allclose(time, SECONDS, rtol=0, atol=1e-9)


EPOCH = 1_700_000_000  # seconds since 1970
NANOSECONDS = np.rint(1e9 * SECONDS).astype(int) + 900_000_000
MICROSECONDS = (2**32 - 250_000 + np.rint(1e6 * SECONDS).astype(int)) % 2**32
UNITS = "[units]\ntime = {}\n[joints.a]"


def time_of_pairs(folder: Path, unit: str) -> np.ndarray:
    """Times of a table with seconds and nanoseconds, or microseconds if the unit is us."""
    divisor = 1000 if unit == "us" else 1
    pairs = [f"{EPOCH + ns // 10**9},{ns % 10**9 // divisor}" for ns in NANOSECONDS]
    rows = "".join(f"{pair},0.1,0.2\n" for pair in pairs)
    (folder / "log.csv").write_text(f"sec,part,goal_a,pos_a\n{rows}", "utf-8")
    return read_log(folder / "log.csv", columns=folder / "map.toml").time


def test_a_list_adds_seconds_and_their_fractions(tmp_path: Path):
    text = MAP.replace('time = "t"', 'time = ["sec", "part"]')
    (tmp_path / "map.toml").write_text(text, "utf-8")
    nanoseconds = time_of_pairs(tmp_path, "ns")
    with pytest.raises(LogError, match="is at most 998000 in 2 seconds") as refused:
        time_of_pairs(tmp_path, "us")

    (tmp_path / "map.toml").write_text(text.replace("[joints.a]", UNITS.format('"us"')), "utf-8")
    microseconds = time_of_pairs(tmp_path, "us")

    assert 'time = "us"' in str(refused.value.remedy)
    np.testing.assert_allclose(np.diff(nanoseconds), 0.002, rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.diff(microseconds), 0.002, rtol=0, atol=1e-8)


def test_rows_of_a_counter_that_are_exchanged_are_no_restart(tmp_path: Path):
    text = MAP.replace('time = "t"', 'time = "t"\ntime_bits = 32')
    cells = MICROSECONDS.copy()
    cells[[40, 41]] = cells[[41, 40]]

    with pytest.raises(LogError, match="row 41, time runs backwards"):
        times(tmp_path / "log.csv", cells.tolist(), text)


def test_a_row_whose_time_repeats_is_left_out(tmp_path: Path):
    cells = 0.002 * np.arange(2000)
    cells[700] = cells[699]

    time = times(tmp_path / "log.csv", cells.tolist())

    np.testing.assert_allclose(time, np.delete(cells, 700))


def test_a_counter_that_restarts_is_continued(tmp_path: Path):
    text = MAP.replace('time = "t"', 'time = "t"\ntime_bits = 32')
    text = text.replace("[joints.a]", UNITS.format('"us"'))

    time = times(tmp_path / "log.csv", MICROSECONDS.tolist(), text)

    np.testing.assert_allclose(time, SECONDS, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("cells", "unit", "cause", "remedy"),
    [
        (NANOSECONDS % 10**9, "ns", "without its seconds", "NANOSECONDS"),
        (EPOCH + NANOSECONDS // 10**9, "s", "whole seconds", "NANOSECONDS"),
        (MICROSECONDS, "us", r"restarts at 2\^32", "time_bits = 32"),
        ((EPOCH + SECONDS).astype(np.float32).astype(int), "s", "128 s", "float64"),
        (np.floor(SECONDS / 0.015625) * 0.015625, "s", "resolves 15.6 ms", "rate"),
        (EPOCH + SECONDS - 0.08 * (SECONDS > 0.3), "s", "set back by 0.078 s", "monotonic"),
    ],
    ids=["nanoseconds", "seconds", "counter", "float32", "coarse", "set_back"],
)
def test_a_clock_that_does_not_increase_is_refused_with_its_cause(
    tmp_path: Path, cells: np.ndarray, unit: str, cause: str, remedy: str
):
    text = MAP.replace("[joints.a]", UNITS.format(f'"{unit}"'))

    with pytest.raises(LogError, match=cause) as refused:
        times(tmp_path / "log.csv", cells.tolist(), text)

    assert remedy in str(refused.value.remedy)
