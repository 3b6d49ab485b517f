"""Motions of isaac-sim2real/sage in the folders that its recorder writes become `MotorLog`s.

A folder holds ``control.csv`` (type, timestamp, positions) and ``state_motor.csv`` (type, timestamp, positions,
velocities, torques), times in µs, the values of all joints in one text ``"[0.1, 0.2]"``, and their names in
``joint_list.txt``. A row of the log is a row of states, with the command in force. Torques have no sign and are left
out. What the joints of a known robot are called stands in the shipped map `so101_sage`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.files import read_text
from motorprior.logs.formats.column_map import ColumnMap, MappedJoint, load_column_map
from motorprior.logs.formats.csv_table import COPY_AGAIN, csv_head, csv_table
from motorprior.logs.formats.log_reader import FOLDER, LogReader
from motorprior.logs.formats.mapped_table import if_it_has, read_mapped_log
from motorprior.logs.formats.table_columns import present, unreadable
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

CONTROL, STATE, JOINTS = "control.csv", "state_motor.csv", "joint_list.txt"
MICROSECOND = 1e-6
_MAP = "so101_sage"
_MAX_NAMES = 100_000


def is_sage_folder(path: Path) -> bool:
    """Whether a folder holds the two tables of a motion."""
    return (path / CONTROL).is_file() and (path / STATE).is_file()


def read_sage(path: str | Path, robot: Robot | None = None) -> MotorLog:
    """Read one motion.

    Args:
        path: the folder.
        robot: the log has its joints' order if these joints are its own.

    Raises:
        LogError: a file that is missing, damaged or another; names the file, the row and the value.
    """
    path = Path(path)
    columns = _columns(path)
    return read_mapped_log(path, columns, if_it_has(robot, tuple(joint.name for joint in columns.joints)), _merged)


SAGE = LogReader("motion of isaac-sim2real/sage", (FOLDER,), is_sage_folder, read_sage)


def _joint_list(path: Path) -> list[str]:
    names = read_text(path / JOINTS, _MAX_NAMES, LogError).split()
    if not names or len(set(names)) != len(names):
        raise LogError("joint names are missing or repeat", where=path / JOINTS, remedy="name each joint on a line")
    return names


def _columns(path: Path) -> ColumnMap:
    """The shipped map, or one with the folder's own names where its joints are others."""
    names, known = _joint_list(path), load_column_map(_MAP)
    if set(names) == {joint.column for joint in known.joints}:
        return known
    return replace(known, robot="", motor="", firmware={}, joints=tuple(MappedJoint(name, name) for name in names))


def _merged(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    joints = _joint_list(path)
    since, (targets,) = _table(path / CONTROL, "CONTROL", ["positions"], len(joints))
    time, (angles, speeds) = _table(path / STATE, "STATE_MOTOR", ["positions", "velocities"], len(joints))
    if np.any(np.diff(since) <= 0.0):
        row = 1 + int(np.argmax(np.diff(since) <= 0.0))
        raise LogError(f"row {row}, time does not increase", where=path / CONTROL, remedy="sort the rows")
    begun = time >= since[0]
    in_force = np.searchsorted(since, time[begun], side="right") - 1
    series = {"q_des": targets[in_force], "q": angles[begun], "dq": speeds[begun]}
    found = {f"{kind}_{joint}": values[:, k] for kind, values in series.items() for k, joint in enumerate(joints)}
    found["t_s"] = MICROSECOND * time[begun]
    return {name: found[name] for name in names}


def _table(path: Path, kind: str, lists: list[str], width: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times (T,) [µs] and each column of lists (T, width) of one file."""
    import pyarrow as pa

    wanted = present(list(csv_head(path).names), ["type", "timestamp", *lists], path)
    try:
        table = csv_table(path, wanted, texts=wanted).combine_chunks()
        if not table.num_rows:
            raise LogError("no rows", where=path, remedy=COPY_AGAIN)
        column = {name: table.column(name).chunk(0) for name in wanted}
        _require_kind(column["type"], kind, path)
        times = _cast(column["timestamp"], "timestamp", path)
        return times, [_lists(column[name], name, width, path) for name in lists]
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        raise unreadable(path, error) from error


def _require_kind(column: Any, kind: str, path: Path) -> None:
    other = np.asarray(column.to_numpy(zero_copy_only=False)) != kind
    if other.any():
        row = int(np.argmax(other))
        problem = f"row {row} is of type {str(column[row])[:40]!r}, not {kind!r}"
        raise LogError(problem, where=path, remedy="restore the file of this name")


def _lists(column: Any, name: str, width: int, path: Path) -> np.ndarray:
    """(rows, width) of texts ``[0.1, 0.2]``."""
    import pyarrow.compute as pc

    cells: Any = pc
    numbers = cells.split_pattern(cells.utf8_trim(column, characters="[] "), ",")
    lengths = np.asarray(cells.fill_null(cells.list_value_length(numbers), 0))
    if np.any(lengths != width):
        row = int(np.argmax(lengths != width))
        problem = f"row {row}, {name} has {lengths[row]} values for {width} joints"
        raise LogError(problem, where=path, remedy=COPY_AGAIN)
    values = _cast(cells.utf8_trim_whitespace(numbers.flatten()), name, path).reshape(-1, width)
    if not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0].tolist()
        problem = f"row {row}, {name}[{column}] is {values[row, column]}, not a finite number"
        raise LogError(problem, where=path, remedy="remove the row")
    return values


def _cast(column: Any, name: str, path: Path) -> np.ndarray:
    import pyarrow as pa

    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False))
    except pa.ArrowInvalid as error:
        problem = f"{name}: {str(error).splitlines()[0][:200]}"
        raise LogError(problem, where=path, remedy=COPY_AGAIN) from error
