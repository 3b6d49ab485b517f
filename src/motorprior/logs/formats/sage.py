"""Motions of isaac-sim2real/sage, in the folders that its recorder writes.

A folder holds ``control.csv`` (timestamp, positions), ``state_motor.csv`` (timestamp, positions, velocities, torques)
and ``joint_list.txt``. Times are in µs; the values of all joints are one text ``"[0.1, 0.2]"``. A row of the log is a
row of states with the command in force. Torques are unsigned and not read. The shipped map `so101_sage` names the
joints.
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
from motorprior.logs.formats.mapped_table import read_mapped_log, robot_of_joints
from motorprior.logs.formats.table_columns import required_columns, unreadable
from motorprior.logs.log_errors import require_finite, require_increasing
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

CONTROL, STATE, JOINTS = "control.csv", "state_motor.csv", "joint_list.txt"
MICROSECOND = 1e-6


def is_sage_folder(path: Path) -> bool:
    """Whether a folder holds the two tables of a motion."""
    return (path / CONTROL).is_file() and (path / STATE).is_file()


def read_sage(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read one motion.

    Args:
        path: the folder.
        robot: gives the order of the joints if it has these joints.

    Raises:
        LogError: a missing, damaged or wrong file; names file, row and value.
    """
    columns = _columns(path)
    robot = robot_of_joints(robot, tuple(joint.name for joint in columns.joints))
    return read_mapped_log(path, columns, _merged, robot)


SAGE = LogReader("motion of isaac-sim2real/sage", (FOLDER,), is_sage_folder, read_sage)


def _joint_list(path: Path) -> list[str]:
    names = read_text(path / JOINTS, 100_000, LogError).split()
    if not names or len(set(names)) != len(names):
        raise LogError("joint names are missing or repeat", where=path / JOINTS, remedy="name each joint on a line")
    return names


def _columns(path: Path) -> ColumnMap:
    """The shipped map, or one with the folder's own joint names if they differ."""
    names, known = _joint_list(path), load_column_map("so101_sage")
    if set(names) == {joint.column for joint in known.joints}:
        return known
    return replace(known, robot="", motor="", firmware={}, joints=tuple(MappedJoint(name, name) for name in names))


def _merged(path: Path, names: list[str]) -> dict[str, np.ndarray]:
    joints = _joint_list(path)
    since, (targets,) = _table(path / CONTROL, ["positions"], len(joints))
    time, (angles, speeds) = _table(path / STATE, ["positions", "velocities"], len(joints))
    require_increasing(MICROSECOND * since, path / CONTROL)
    begun = time >= since[0]
    in_force = np.searchsorted(since, time[begun], side="right") - 1
    series = {"q_des": targets[in_force], "q": angles[begun], "dq": speeds[begun]}
    found = {f"{kind}_{joint}": values[:, k] for kind, values in series.items() for k, joint in enumerate(joints)}
    found["t_s"] = MICROSECOND * time[begun]
    return {name: found[name] for name in names}


def _table(path: Path, lists: list[str], width: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times (T,) [µs] and each column of lists (T, width) of one file."""
    import pyarrow as pa

    wanted = required_columns(list(csv_head(path).names), ["timestamp", *lists], path)
    try:
        table = csv_table(path, wanted, texts=lists).combine_chunks()
        if not table.num_rows:
            raise LogError("no rows", where=path, remedy=COPY_AGAIN)
        times = np.asarray(table.column("timestamp").to_numpy())
        return times, [_lists(table.column(name).chunk(0), name, width, path) for name in lists]
    except (pa.ArrowException, OSError, EOFError, UnicodeDecodeError) as error:
        raise unreadable(path, error) from error


def _lists(column: Any, name: str, width: int, path: Path) -> np.ndarray:
    """(rows, width) of texts ``[0.1, 0.2]``."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells: Any = pc
    numbers = cells.split_pattern(cells.utf8_trim(column, characters="[] "), ",")
    lengths = np.asarray(cells.fill_null(cells.list_value_length(numbers), 0))
    if np.any(lengths != width):
        row = int(np.argmax(lengths != width))
        problem = f"row {row}, {name} has {lengths[row]} values for {width} joints"
        raise LogError(problem, where=path, remedy=COPY_AGAIN)
    values = cells.utf8_trim_whitespace(numbers.flatten()).cast(pa.float64())
    table = np.asarray(values.to_numpy(zero_copy_only=False)).reshape(-1, width)
    require_finite(table, [f"{name}[{index}]" for index in range(width)], path)
    return table
