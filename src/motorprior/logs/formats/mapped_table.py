"""Columns that a `ColumnMap` names become a `MotorLog`: of tables, files of tensors or any other source of columns."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown
from motorprior.logs.formats.column_map import ColumnMap, MappedJoint
from motorprior.logs.formats.column_units import Conversion
from motorprior.logs.formats.csv_table import COPY_AGAIN
from motorprior.logs.formats.table_columns import CORRECT, POSTURE_NAMES, table_columns
from motorprior.logs.formats.tensor_file import tensor_columns
from motorprior.logs.motor_log import POSTURES, MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

Columns = Callable[[Path, list[str]], dict[str, np.ndarray]]
"""The named columns of a file or folder, each (rows,) float64, timedelta64 of time stamps or int64 of postures."""
_SI = Conversion()


def read_mapped_log(
    path: str | Path, columns: ColumnMap, robot: Robot | None = None, source: Columns | None = None
) -> MotorLog:
    """Read a table.

    Args:
        path: .csv, .csv.gz, .parquet or .pt; its first line, its schema or its keys name the columns.
        columns: what they mean.
        robot: whose joints these are, in whose order the log will have them; the map's own names and order without. Its
            angles are measured where the robot's are, unless the map says where.
        source: reads the columns of a path that is none of these.

    Raises:
        LogError: missing or damaged file, a column that it lacks, a cell that is not a finite number or no posture,
            joints that are not the robot's; names the file, the column and the value.
    """
    path = Path(path)
    source = source or _source(path, columns)
    joints = _in_order(columns, robot, path)
    wanted = {channel: columns.columns_of(channel, joints) for channel in columns.series}
    singles = [name for name in (columns.time, columns.segment, columns.posture_column) if name]
    every = [*singles, *(name for names in wanted.values() for name in names)]
    table = source(path, list(dict.fromkeys(every)))
    rows = len(next(iter(table.values())))
    if not rows:
        raise LogError("no rows", where=path, remedy=COPY_AGAIN)
    values = _channels(table, wanted, joints, columns, path)
    values |= {name: np.broadcast_to(gains, (rows, len(joints))) for name, gains in columns.gains(joints).items()}
    values |= {name: np.full((rows, len(joints)), value) for name, value in columns.conditions.items()}
    if columns.posture in POSTURES:
        values["posture"] = np.full(rows, POSTURES.index(columns.posture))
    return checked(
        MotorLog(
            joint_names=tuple(joint.name for joint in joints), robot=robot.name if robot else columns.robot,
            motor=columns.motor, source=str(path),
            encoder=columns.encoder or (robot.encoder if robot else "joint"),
            gain_unit=columns.gain_unit, firmware=columns.firmware, **values,
        ),
        where=path,
    )  # fmt: skip


def require_one_posture(columns: ColumnMap, path: Path, kind: str) -> None:
    """Refuse a map that names a column of postures, for a kind of file that has no texts.

    Raises:
        LogError: names the column.
    """
    if columns.posture_column:
        raise LogError(
            f"the column map {columns.source} says posture = {shown(columns.posture_column)}: not a posture, and "
            f"{kind} has no text columns",
            where=path, remedy=f"state one posture for all rows: {POSTURE_NAMES}",
        )  # fmt: skip


def if_it_has(robot: Robot | None, joint_names: tuple[str, ...]) -> Robot | None:
    """The robot, if all these joints are its own: a log that names its joints may be of another one."""
    return robot if robot is not None and set(joint_names) <= set(robot.joint_names) else None


def _source(path: Path, columns: ColumnMap) -> Columns:
    if path.suffix != ".pt":
        return partial(table_columns, time=columns.time, posture=columns.posture_column)
    require_one_posture(columns, path, "a file of tensors")
    return tensor_columns


def _in_order(columns: ColumnMap, robot: Robot | None, path: Path) -> tuple[MappedJoint, ...]:
    if robot is None:
        return columns.joints
    by_name = {joint.name: joint for joint in columns.joints}
    if strange := sorted(by_name.keys() - set(robot.joint_names)):
        raise LogError(
            f"the column map {columns.source} has a joint {strange[0]!r}, robot {robot.name} has none of that name",
            where=path, remedy=f"remove its table, or give its key name one of {', '.join(robot.joint_names)}",
        )  # fmt: skip
    return tuple(by_name[name] for name in robot.joint_names if name in by_name)


def _channels(
    table: dict[str, np.ndarray], wanted: dict[str, list[str]], joints: tuple[MappedJoint, ...], columns: ColumnMap,
    path: Path,
) -> dict[str, Any]:  # fmt: skip
    """The channels in SI units."""
    values: dict[str, Any] = {"time": _time(table, columns, path)}
    for channel, names in wanted.items():
        raw = np.stack([table[name] for name in names], axis=1)
        _require_finite(raw, names, [f"{channel}/{joint.name}" for joint in joints], path)
        values[channel] = _in_si(channel, raw, joints)
    if columns.segment:
        values["segment"] = _whole(table[columns.segment], columns.segment, path)
    if columns.posture_column:
        values["posture"] = table[columns.posture_column]
    return values


def _time(table: dict[str, np.ndarray], columns: ColumnMap, path: Path) -> np.ndarray:
    """(rows,) [s]."""
    if columns.rate is not None:
        return np.arange(len(next(iter(table.values())))) / columns.rate
    name = columns.time or ""
    time = table[name]
    if time.dtype.kind != "m":
        _require_finite(time[:, None], [name], ["time"], path)
        return columns.time_scale * time
    if columns.time_scale != 1.0:
        problem = f"{name} holds time stamps, which have a unit of their own"
        raise LogError(problem, where=path, remedy=f"remove time from [units] of {columns.source}")
    return time / np.timedelta64(1, "s")


def _require_finite(raw: np.ndarray, names: list[str], channels: list[str], path: Path) -> None:
    """Check that all values are finite; names the column and its channel."""
    if np.isfinite(raw).all():
        return
    row, column = np.argwhere(~np.isfinite(raw))[0].tolist()
    of = channels[column] if names[column] == channels[column] else f"{channels[column]} (column {names[column][:80]})"
    raise LogError(
        f"row {row}, {of} is {raw[row, column]}, not a finite number", where=path,
        remedy="remove the row, or split the recording into two segments there",
    )  # fmt: skip


def _in_si(channel: str, raw: np.ndarray, joints: tuple[MappedJoint, ...]) -> np.ndarray:
    known = [joint.conversions.get(channel, _SI) for joint in joints]
    factor, offset = np.array([each.factor for each in known]), np.array([each.offset for each in known])
    values = factor * raw
    values += offset
    return values


def _whole(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    odd = np.flatnonzero((values != np.rint(values)) | ~np.isfinite(values))
    if odd.size:
        problem = f"row {odd[0]}, {name} is {values[odd[0]]:g}, not a whole number"
        raise LogError(problem, where=path, remedy=CORRECT)
    return values.astype(np.int64)
