"""Build a `MotorLog` from the columns that a `ColumnMap` names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.column_map import ColumnMap, MappedJoint
from motorprior.logs.formats.column_units import Conversion
from motorprior.logs.formats.csv_table import COPY_AGAIN
from motorprior.logs.log_errors import CORRECT, bad_value, require_finite
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

# Reads named columns of a path, each (rows,) float64, timedelta64 for time stamps or int64 for postures
Columns = Callable[[Path, list[str]], dict[str, np.ndarray]]


def read_mapped_log(path: Path, columns: ColumnMap, source: Columns, robot: Robot | None = None) -> MotorLog:
    """Read a table.

    Args:
        path: file or folder.
        columns: meaning of its columns.
        source: reads columns by name.
        robot: gives the order of the joints, and the place of the encoder unless the map does. Without a robot, the
            map's order.

    Raises:
        LogError: as ``source``; no rows, a cell that is not finite, or a joint that the robot does not have.
    """
    joints = _in_order(columns, robot, path)
    wanted = {channel: columns.columns_of(channel, joints) for channel in columns.series}
    singles = [name for name in (columns.time, columns.segment, columns.posture_column) if name]
    table = source(path, list(dict.fromkeys([*singles, *(name for names in wanted.values() for name in names)])))
    rows = len(next(iter(table.values())))
    if not rows:
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)
    values: dict[str, Any] = {"time": _time(table, columns, path)}
    for channel, names in wanted.items():
        raw = np.stack([table[name] for name in names], axis=1)
        labels = [f"{channel}/{joint.name} (column {name})" for joint, name in zip(joints, names, strict=True)]
        require_finite(raw, labels, path)
        values[channel] = _in_si(channel, raw, joints)
    values |= {name: np.broadcast_to(gains, (rows, len(joints))) for name, gains in columns.gains(joints).items()}
    values |= {name: np.full((rows, len(joints)), value) for name, value in columns.conditions.items()}
    if columns.segment:
        values["segment"] = _integers(table[columns.segment], columns.segment, path)
    if columns.posture_column:
        values["posture"] = table[columns.posture_column]
    elif columns.posture:
        values["posture"] = np.full(rows, POSTURES.index(columns.posture))
    log = MotorLog(
        joint_names=tuple(joint.name for joint in joints), robot=robot.name if robot else columns.robot,
        motor=columns.motor, source=str(path), encoder=columns.encoder or (robot.encoder if robot else "joint"),
        gain_unit=columns.gain_unit, firmware=columns.firmware, **values,
    )  # fmt: skip
    return checked(log, where=path)


def robot_of_joints(robot: Robot | None, joint_names: tuple[str, ...]) -> Robot | None:
    """The robot if it has all these joints, else None: a log that names its joints may be of another robot."""
    return robot if robot is not None and set(joint_names) <= set(robot.joint_names) else None


def _in_order(columns: ColumnMap, robot: Robot | None, path: Path) -> tuple[MappedJoint, ...]:
    if robot is None:
        return columns.joints
    by_name = {joint.name: joint for joint in columns.joints}
    if unknown := sorted(by_name.keys() - set(robot.joint_names)):
        raise LogError(
            f"the column map {columns.source} has a joint {unknown[0]!r}, robot {robot.name} has none of that name",
            where=path, remedy=f"remove its table, or give its key name one of {', '.join(robot.joint_names)}",
        )  # fmt: skip
    return tuple(by_name[name] for name in robot.joint_names if name in by_name)


def _time(table: dict[str, np.ndarray], columns: ColumnMap, path: Path) -> np.ndarray:
    """(rows,) [s]."""
    if columns.rate is not None:
        return np.arange(len(next(iter(table.values())))) / columns.rate
    time = table[columns.time or ""]
    if time.dtype.kind != "m":
        require_finite(time[:, None], [f"time (column {columns.time})"], path)
        return columns.time_scale * time
    if columns.time_scale != 1.0:
        problem = f"{columns.time} holds time stamps, which have a unit of their own"
        raise LogError(problem, where=path, remedy=f"remove time from [units] of {columns.source}")
    return time / np.timedelta64(1, "s")


def _in_si(channel: str, raw: np.ndarray, joints: tuple[MappedJoint, ...]) -> np.ndarray:
    known = [joint.conversions.get(channel, Conversion()) for joint in joints]
    factor, offset = np.array([each.factor for each in known]), np.array([each.offset for each in known])
    values = factor * raw
    values += offset
    return values


def _integers(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    wrong = np.flatnonzero((values != np.rint(values)) | ~np.isfinite(values))
    if wrong.size:
        raise bad_value(int(wrong[0]), name, values[wrong[0]], "an integer", path, CORRECT)
    return values.astype(np.int64)
