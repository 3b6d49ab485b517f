"""How formats are read: the interface of a format, and logs from the columns that a `ColumnMap` names."""

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
# Reads named columns of a path, each (rows,) float64, or timedelta64 for time stamps
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
    # (path, robot, period [s], suspended) the log on a grid, for a format that knows more than its
    # rows
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

    A robot gives the order of the joints, and the place of the encoder unless the map does. Raises
    LogError as ``source``, or for a cell that is not finite, or a joint that the robot does not
    have.
    """
    joints = _in_order(columns, robot, path)
    wanted = {channel: columns.columns_of(channel, joints) for channel in columns.series}
    names = [
        *filter(None, (columns.time, columns.segment)),
        *columns.base_orientation,
        *chain(*wanted.values()),
    ]
    table = source(path, list(dict.fromkeys(names)), columns)
    origin = str(path)
    same = np.all([values[1:] == values[:-1] for values in table.values()], axis=0)
    if columns.time and (duplicate := np.append(False, same)).any():
        table = {name: values[~duplicate] for name, values in table.items()}
        origin = f"{path} (duplicate rows left out: {duplicate.sum()})"
    shape = len(next(iter(table.values()))), len(joints)
    if columns.rate is not None:
        time = np.arange(shape[0]) / columns.rate
    elif (time := table[columns.time or ""]).dtype.kind == "m":
        time = time / np.timedelta64(1, "s")
    else:
        require_finite(time[:, None], [f"time (column {columns.time})"], path)
        time = columns.time_scale * time
    values: dict[str, Any] = {"time": time}
    for channel, names in wanted.items():
        raw = np.stack([table[name] for name in names], axis=1)
        labels = [
            f"{channel}/{joint.name} (column {name})"
            for joint, name in zip(joints, names, strict=True)
        ]
        require_finite(raw, labels, path)
        known = [joint.conversions.get(channel, Conversion()) for joint in joints]
        values[channel] = np.array([each.factor for each in known]) * raw + np.array(
            [each.offset for each in known]
        )
        wraps = np.array([each.wraps for each in known])
        values[channel][:, wraps] = np.unwrap(values[channel][:, wraps], period=TURN, axis=0)
        if channel == "joint_pos" and wraps.any():  # in the turn of the command
            turns = np.rint(np.median(values["position_target"] - values[channel], axis=0) / TURN)
            values[channel][:, wraps] += TURN * turns[wraps]
    for name in GAINS:
        if None not in (gains := [getattr(joint, name) for joint in joints]):
            values[f"logged_{name}"] = np.broadcast_to(gains, shape)
    values |= {name: np.full(shape, value) for name, value in columns.operating_conditions.items()}
    if columns.base_orientation:
        values["base_orientation"] = np.stack(
            [table[name] for name in columns.base_orientation], axis=1
        )
    if columns.segment:
        segment = table[columns.segment]
        if not np.all(whole := segment == np.rint(segment)):
            row = int(np.argmin(whole))
            raise bad_value(row, columns.segment, segment[row], "an integer", path, CORRECT)
        values["segment"] = segment.astype(np.int64)
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


def robot_of_joints(robot: Robot | None, joint_names: tuple[str, ...]) -> Robot | None:
    """The robot if it has all these joints, else None: a log that names its joints may be of another robot."""
    return robot if robot is not None and set(joint_names) <= set(robot.joint_names) else None


def _in_order(columns: ColumnMap, robot: Robot | None, path: Path) -> tuple[MappedJoint, ...]:
    if robot is None:
        return columns.joints
    by_name = {joint.name: joint for joint in columns.joints}
    if unknown := sorted(by_name.keys() - set(robot.joint_names)):
        problem = f"the column map {columns.source} has a joint {unknown[0]!r}, robot {robot.name} has none such"
        remedy = f"remove its table, or give its key name one of {', '.join(robot.joint_names)}"
        raise LogError(problem, where=path, remedy=remedy)
    return tuple(by_name[name] for name in robot.joint_names if name in by_name)
