"""How many numbers a motor log on disk may hold: what is written can be read again."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from motorprior.exceptions import LogError
from motorprior.logs.formats.parquet_pages import MAX_NUMBERS
from motorprior.logs.motor_log import BASE_AXES, CODES, JOINT_SERIES, MotorLog

MAX_LOG_NUMBERS = 4 * MAX_NUMBERS
"""Two gigabytes. An import adds velocities, loads and gains to commands and angles: eight numbers per joint and row
instead of two, so that every table that can be read fits with its loads."""


def numbers_per_row(present: Collection[str], num_joints: int) -> int:
    """Columns of a motor log of these channels, its time among them."""
    width = {"time": 1, "base_orientation": len(BASE_AXES)} | dict.fromkeys(CODES, 1)
    return sum(width.get(name, num_joints if name in JOINT_SERIES else 0) for name in {"time", *present})


def most_rows(per_row: int) -> int:
    """Rows of so many numbers that a motor log may have."""
    return MAX_LOG_NUMBERS // per_row


def require_log_size(log: MotorLog, present: Collection[str], where: Path) -> None:
    """Refuse a log that could not be read again.

    Args:
        log: that is to be written.
        present: its channels.
        where: its file.

    Raises:
        LogError: more than MAX_LOG_NUMBERS numbers; tells rows and minutes, and how many there may be.
    """
    most = most_rows(per_row := numbers_per_row(present, log.num_joints))
    if log.num_rows > most:
        minutes = log.duration / 60.0
        problem = (
            f"{log.num_rows:,} rows of {per_row} numbers, {minutes:.3g} minutes: a motor log has at most {most:,} "
            f"such rows, {minutes * most / log.num_rows:.3g} minutes of this one"
        )
        raise LogError(problem, where=where, remedy="split the recording, or import it with a longer period")
