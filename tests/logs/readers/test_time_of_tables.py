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
        rows = "".join(f"{cell},0.1,0.2\n" for cell in cells)
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
