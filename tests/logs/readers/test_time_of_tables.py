"""When rows were recorded: numbers, a known rate, or time stamps, which are read as seconds since the first row."""

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.read_log import read_log

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
def test_time_stamps_of_a_table_of_text_are_seconds_since_the_first_row(tmp_path: Path, zone: timezone | None):
    log = read(tmp_path / "log.csv", [each.isoformat(sep=" ") for each in stamps(zone)])
    np.testing.assert_allclose(log.time, SECONDS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE)


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
@pytest.mark.parametrize(
    ("row", "cell", "said"),
    [
        (2500, "2024-03-31T01:00:02.25Z", "not a time stamp like the others"),
        (2500, "yesterday", "'yesterday'"),
        (7, "", "row 7"),
    ],
)
def test_a_bad_time_stamp_is_named(tmp_path: Path, name: str, row: int, cell: str, said: str):
    some = [each.isoformat() for each in stamps()]
    some[row] = cell
    with pytest.raises(LogError, match=said) as refusal:
        read(tmp_path / name, some)
    assert str(refusal.value.where).endswith(name) and f"row {row}" in refusal.value.problem


@pytest.mark.parametrize("name", ["log.csv", "log.parquet"])
def test_a_known_rate_stands_for_the_time(tmp_path: Path, name: str):
    log = read(tmp_path / name, SECONDS.tolist(), MAP.replace('time = "when"', "rate = 500"))
    np.testing.assert_allclose(log.time, SECONDS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(log.joint_pos[:, 0], ANGLE)
