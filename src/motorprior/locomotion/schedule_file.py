"""Commands of a walk from a CSV file with the columns time_s, forward_m_s, yaw_rate_rad_s."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.exceptions import ConfigError, LogError
from motorprior.locomotion.command import Timetable
from motorprior.logs.tables import read_number_table
from motorprior.robots.robot import Robot

COLUMNS = ("time_s", "forward_m_s", "yaw_rate_rad_s")


def read_schedule(path: Path, robot: Robot) -> Timetable:
    """Read the commands; each is in force until the time of the next row.

    Raises:
        ConfigError: the file cannot be read, or a row is outside the robot's range; names row (from 0), value, range.
    """
    try:
        table = read_number_table(path, COLUMNS)
    except LogError as error:
        remedy = f"write the columns {', '.join(COLUMNS)} and a number in every cell"
        raise ConfigError(error.problem, where=error.where, remedy=remedy) from error
    size = robot.require_legs()
    earliest = np.append(0.0, np.nextafter(table[:-1, 0], np.inf))  # times increase
    low = np.column_stack([earliest, *np.full((2, len(table)), [[size.forward[0]], [-size.yaw_rate]])])
    high = np.broadcast_to([np.finfo(float).max, size.forward[1], size.yaw_rate], table.shape)
    for row, column in np.argwhere(~((table >= low) & (table <= high)))[:1]:
        after = f"after {table[row - 1, 0]:g} (times must increase)" if row else "at least 0"
        allowed = after if column == 0 else f"within {low[row, column]:g} to {high[row, column]:g}"
        raise ConfigError(
            f"row {row}: {COLUMNS[column]} is {table[row, column]:g}, but must be {allowed}", where=path,
            remedy=f"give commands in the range of robot {robot.name!r}, ordered by time",
        )  # fmt: skip
    return Timetable(tuple((float(time), float(forward), float(turn)) for time, forward, turn in table))
