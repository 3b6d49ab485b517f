"""Commands of a walk from a CSV file with the columns time_s, forward_m_s, yaw_rate_rad_s."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.exceptions import ConfigError, LogError
from motorprior.locomotion.timetable import Timetable
from motorprior.logs.formats.number_table import read_number_table
from motorprior.robots.robot import Robot

COLUMNS = ("time_s", "forward_m_s", "yaw_rate_rad_s")
_MOST_ROWS = 100_000


def read_schedule(path: Path, robot: Robot) -> Timetable:
    """The commands in a file, each held until the time of the next row.

    Raises:
        ConfigError: a file that is none, or a row that the robot cannot follow: names the file, the row from 0, the
            value and its bound.
    """
    try:
        table = read_number_table(path, COLUMNS)
    except LogError as error:
        raise ConfigError(
            error.problem,
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
                f"row {row}: {name} {table[row, column]:g} is not within {least:g} to {most:g}, which robot "
                f"{robot.name!r} can be told here", where=path, remedy="give a command that it can follow",
            )  # fmt: skip
    return Timetable(tuple((float(time), float(forward), float(turn)) for time, forward, turn in table))


def _require_order(time: np.ndarray, path: Path) -> None:
    before = np.concatenate([[-np.inf], time[:-1]])
    for row in np.flatnonzero(~((time > before) & (time >= 0.0) & np.isfinite(time)))[:1]:
        earlier = "not a time from 0 s on" if row == 0 else f"not after the {before[row]:g} s of the row before"
        raise ConfigError(
            f"row {row}: {COLUMNS[0]} {time[row]:g} is {earlier}", where=path, remedy="order the rows by their time"
        )
