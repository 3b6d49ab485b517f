"""Commands of a walk from a CSV file with the columns time_s, forward_m_s, yaw_rate_rad_s."""

from __future__ import annotations

import gzip
import re
from itertools import islice
from pathlib import Path

import numpy as np

from motorprior.exceptions import ConfigError, LogError
from motorprior.locomotion.timetable import Timetable
from motorprior.logs.formats.csv_table import read_number_table
from motorprior.robots.robot import Robot

COLUMNS = ("time_s", "forward_m_s", "yaw_rate_rad_s")
_MOST_ROWS = 100_000
_ROW = re.compile(r"^(?:(a quote is opened in )?row |(the rows from )(?=\d))(\d+)")
"""How `read_number_table` names a row, from 0; a column's name may say the same elsewhere."""


def read_schedule(path: Path, robot: Robot) -> Timetable:
    """The commands in a file, each held until the time of the next row.

    Raises:
        ConfigError: a file that is none, or a row that the robot cannot follow: names the file, its line, the value
            and its bound.
    """
    try:
        table = read_number_table(path, COLUMNS)
    except LogError as error:
        raise ConfigError(
            _ROW.sub(lambda row: f"{row[1] or row[2] or ''}line {_line_of(path, int(row[3]))}", error.problem),
            where=error.where,
            remedy=f"write the columns {', '.join(COLUMNS)} and a number in every cell",
        ) from error
    if len(table) > _MOST_ROWS:
        raise ConfigError(f"{len(table)} rows, more than {_MOST_ROWS}", where=path, remedy="give fewer commands")
    _require_order(table[:, 0], path)
    size = robot.require_legs()
    bounds = {COLUMNS[1]: size.forward, COLUMNS[2]: (-size.yaw_rate, size.yaw_rate)}
    for column, (name, (least, most)) in enumerate(bounds.items(), start=1):
        for row in np.flatnonzero(~((table[:, column] >= least) & (table[:, column] <= most)))[:1]:
            raise ConfigError(
                f"line {_line_of(path, row)}: {name} {table[row, column]:g} is not within {least:g} to {most:g}, which "
                f"robot {robot.name!r} can be told here", where=path, remedy="give a command that it can follow",
            )  # fmt: skip
    return Timetable(tuple((float(time), float(forward), float(turn)) for time, forward, turn in table))


def _require_order(time: np.ndarray, path: Path) -> None:
    before = np.concatenate([[-np.inf], time[:-1]])
    for row in np.flatnonzero(~((time > before) & (time >= 0.0) & np.isfinite(time)))[:1]:
        earlier = "not a time from 0 s on" if row == 0 else f"not after the {before[row]:g} s of the line before"
        raise ConfigError(
            f"line {_line_of(path, row)}: {COLUMNS[0]} {time[row]:g} is {earlier}", where=path,
            remedy="order the lines by their time",
        )  # fmt: skip


def _line_of(path: Path, row: int) -> int:
    """Line of the file, from 1, with a row of numbers, from 0: the names come first, and empty lines are no rows."""
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rb") as file:
        filled = (number for number, line in enumerate(file, start=1) if line.strip(b"\r\n"))
        return next(islice(filled, row + 1, None))
