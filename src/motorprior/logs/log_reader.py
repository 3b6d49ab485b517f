"""The interface of a log format, and logs from the columns that a `ColumnMap` names."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.column_map import GAINS, TURN, ColumnMap, Conversion, MappedJoint
from motorprior.logs.motor_log import (
    CORRECT,
    POSTURES,
    MotorLog,
    bad_value,
    checked,
    require_finite,
)
from motorprior.robots.robot import Robot

FOLDER = "/"  # the ending of a folder's name
GIVE_COLUMNS = "with columns, the file of a column map (docs/your-motors.md)"
# reads named columns of a path, each (rows,) float64, or timedelta64 for time stamps
Columns: TypeAlias = Callable[[Path, list[str], ColumnMap], dict[str, np.ndarray]]


@dataclass(frozen=True)
class LogReader:
    """A log format; the READER of a module in `logs.readers`."""

    name: str  # name in messages
    endings: tuple[str, ...]  # endings of its file names with the dot, or FOLDER
    # whether a path with such an ending has this format
    recognises: Callable[[Path], bool] = lambda path: True
    # None if the format needs a column map
    read: Callable[[Path, Robot | None], MotorLog] | None = None
    columns: Columns | None = None  # for a column map; None if it needs none
    # text about the content, for the error if a format that needs a map is read without
    unmapped: Callable[[Path], str] = lambda path: ""
    # (path, robot, period [s], suspended) -> the log on a grid, for a format that has more
    # information than its rows
    on_grid: Callable[[Path, Robot | None, float, bool], MotorLog] | None = None
    needs_robot: bool = False  # whether it needs a robot, since it does not name its joints
    # a sentence for the user about what is assumed because the format lacks it
    assumption: str = ""

    def matches(self, path: Path) -> bool:
        """Whether an existing path has this format; raises `LogError` if it cannot be read."""
        name = path.name + FOLDER if path.is_dir() else path.name
        return name.endswith(self.endings) and self.recognises(path)


def require_robot(robot: Robot | None, path: Path) -> Robot:
    """The robot of a format that does not name its joints; raises ConfigError if none was given."""
    if robot is None:
        raise ConfigError(
            "the log does not name its joints", where=path, remedy="give robot", argument="robot"
        )
    return robot


def read_mapped_log(
    path: Path, columns: ColumnMap, source: Columns, robot: Robot | None = None
) -> MotorLog:
    """The log of the columns of a path that ``source`` reads.

    A robot gives the order of the joints, and the place of the encoder unless the map does.

    Raises:
        LogError: as ``source``; a cell that is not finite, or a joint that the robot does not have.
    """
    joints = _in_order(columns, robot, path)
    series = {channel: columns.columns_of(channel, joints) for channel in columns.series}
    table = source(path, _column_names(columns, series), columns)
    origin = str(path)
    if columns.time:
        table, num_duplicates = _without_duplicates(table)
        if num_duplicates:
            origin = f"{path} (duplicate rows left out: {num_duplicates})"

    shape = (len(next(iter(table.values()))), len(joints))
    values: dict[str, Any] = {"time": _time(table, columns, shape[0], path)}
    for channel, names in series.items():
        values[channel] = _converted(table, channel, names, joints, path)
    _match_turns(values, joints)

    for name in GAINS:
        gains = [getattr(joint, name) for joint in joints]
        if None not in gains:
            values[f"logged_{name}"] = np.broadcast_to(gains, shape)
    for name, value in columns.operating_conditions.items():
        values[name] = np.full(shape, value)
    if columns.base_orientation:
        angles = [table[name] for name in columns.base_orientation]
        values["base_orientation"] = np.stack(angles, axis=1)
    if columns.segment:
        values["segment"] = _integers(table[columns.segment], columns.segment, path)
    if columns.posture:
        values["posture"] = np.full(shape[0], POSTURES.index(columns.posture))

    log = MotorLog(
        joint_names=tuple(joint.name for joint in joints),
        robot=robot.name if robot else columns.robot,
        motor=columns.motor,
        source=origin,
        encoder=columns.encoder or (robot.encoder if robot else "joint"),
        gain_unit=columns.gain_unit,
        firmware=columns.firmware,
        **values,
    )
    return checked(log)


def _column_names(columns: ColumnMap, series: dict[str, list[str]]) -> list[str]:
    """Each column that the log needs, once."""
    names = [name for name in (columns.time, columns.segment) if name]
    names += columns.base_orientation
    names += chain(*series.values())
    return list(dict.fromkeys(names))


def _without_duplicates(table: dict[str, np.ndarray]) -> tuple[dict[str, np.ndarray], int]:
    """The rows that differ from the previous row, and the number of the others."""
    is_equal = np.all([values[1:] == values[:-1] for values in table.values()], axis=0)
    duplicate = np.append(False, is_equal)
    if not duplicate.any():
        return table, 0
    return {name: values[~duplicate] for name, values in table.items()}, int(duplicate.sum())


def _time(
    table: dict[str, np.ndarray], columns: ColumnMap, num_rows: int, path: Path
) -> np.ndarray:
    """(T,) [s]."""
    if columns.rate is not None:
        return np.arange(num_rows) / columns.rate
    time = table[columns.time or ""]
    if time.dtype.kind == "m":
        return time / np.timedelta64(1, "s")
    require_finite(time[:, None], [f"time (column {columns.time})"], path)
    return columns.time_scale * time


def _converted(
    table: dict[str, np.ndarray],
    channel: str,
    names: list[str],
    joints: tuple[MappedJoint, ...],
    path: Path,
) -> np.ndarray:
    """(T, J) values of a channel in SI units, unwrapped."""
    columns = np.stack([table[name] for name in names], axis=1)
    labels = [
        f"{channel}/{joint.name} (column {name})" for joint, name in zip(joints, names, strict=True)
    ]
    require_finite(columns, labels, path)

    conversions = [joint.conversions.get(channel, Conversion()) for joint in joints]
    factors = np.array([conversion.factor for conversion in conversions])
    offsets = np.array([conversion.offset for conversion in conversions])
    values = factors * columns + offsets

    wraps = np.array([conversion.wraps for conversion in conversions])
    values[:, wraps] = np.unwrap(values[:, wraps], period=TURN, axis=0)
    return values


def _match_turns(values: dict[str, np.ndarray], joints: tuple[MappedJoint, ...]) -> None:
    """Put unwrapped angles into the turn of their command."""
    for index, joint in enumerate(joints):
        if joint.conversions.get("joint_pos", Conversion()).wraps:
            angle = values["joint_pos"][:, index]
            turns = np.rint(np.median(values["position_target"][:, index] - angle) / TURN)
            values["joint_pos"][:, index] += TURN * turns


def _integers(column: np.ndarray, name: str, path: Path) -> np.ndarray:
    is_integer = column == np.rint(column)
    if not np.all(is_integer):
        row = int(np.argmin(is_integer))
        raise bad_value(row, name, column[row], "an integer", path, CORRECT)
    return column.astype(np.int64)


def robot_of_joints(robot: Robot | None, joint_names: tuple[str, ...]) -> Robot | None:
    """The robot if it has all these joints, else None.

    A log that names its joints may be of another robot.
    """
    if robot is None or not set(joint_names) <= set(robot.joint_names):
        return None
    return robot


def _in_order(columns: ColumnMap, robot: Robot | None, path: Path) -> tuple[MappedJoint, ...]:
    """The joints of the map, in the order of the robot."""
    if robot is None:
        return columns.joints
    by_name = {joint.name: joint for joint in columns.joints}
    unknown = sorted(by_name.keys() - set(robot.joint_names))
    if unknown:
        raise LogError(
            f"the column map {columns.source} has a joint {unknown[0]!r}, robot {robot.name} has "
            "none such",
            where=path,
            remedy=f"remove its table, or give its key name one of {', '.join(robot.joint_names)}",
        )
    return tuple(by_name[name] for name in robot.joint_names if name in by_name)
