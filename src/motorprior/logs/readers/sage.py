"""Motions of isaac-sim2real/sage, in the folders that its recorder writes.

A folder holds ``control.csv`` (timestamp, positions), ``state_motor.csv`` (timestamp, positions,
velocities, torques) and ``joint_list.txt``. Times are in µs; the values of all joints are one text
``"[0.1, 0.2]"``. A row of the log is a row of states with the command in force. Torques are
unsigned and not read. The shipped map `so101_sage` names the joints.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_text
from motorprior.exceptions import LogError
from motorprior.logs.column_map import ColumnMap, MappedJoint, load_column_map
from motorprior.logs.log_reader import FOLDER, LogReader, read_mapped_log, robot_of_joints
from motorprior.logs.motor_log import COPY_AGAIN, MotorLog, bad_value, require_increasing
from motorprior.logs.readers.table import csv_table
from motorprior.robots.robot import Robot

CONTROL = "control.csv"
STATE = "state_motor.csv"
MICROSECOND = 1e-6


def read_sage(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read the folder of one motion; a robot gives the order if it has these joints."""
    names = read_text(path / "joint_list.txt", LogError).split()
    columns = load_column_map("so101_sage")
    if set(names) != {joint.column for joint in columns.joints}:  # another robot
        joints = tuple(MappedJoint(name, name) for name in names)
        columns = replace(columns, robot="", motor="", firmware={}, joints=joints)

    def selected(path: Path, column_names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
        values = _columns(path, names)
        return {name: values[name] for name in column_names}

    joint_names = tuple(joint.name for joint in columns.joints)
    return read_mapped_log(path, columns, selected, robot_of_joints(robot, joint_names))


def _columns(path: Path, joints: list[str]) -> dict[str, np.ndarray]:
    """Columns of the states, and of the command in force at each of them."""
    since, targets = _table(path / CONTROL, ["positions"], len(joints))
    time, positions, velocities = _table(path / STATE, ["positions", "velocities"], len(joints))
    require_increasing(since, path / CONTROL)

    has_command = time >= since[0]
    time = time[has_command]
    in_force = np.searchsorted(since, time, side="right") - 1
    tables = {
        "q_des": targets[in_force],
        "q": positions[has_command],
        "dq": velocities[has_command],
    }

    columns = {"t_s": time}
    for quantity, table in tables.items():
        for joint, column in zip(joints, table.T, strict=True):
            columns[f"{quantity}_{joint}"] = column
    return columns


def _table(path: Path, lists: list[str], width: int) -> list[np.ndarray]:
    """Times (T,) [s] of one file, and each of its columns of texts ``[0.1, 0.2]`` as (T, width)."""
    table = csv_table(path, ["timestamp", *lists], inferred=lists)
    columns = [MICROSECOND * table.column("timestamp").to_numpy()]
    for name in lists:
        rows = np.empty((table.num_rows, width))
        for row, text in enumerate(table.column(name).to_pylist()):
            try:
                rows[row] = np.reshape(json.loads(text), width)
            except (TypeError, ValueError) as error:
                expected = f"a list of {width} numbers"
                raise bad_value(row, name, text, expected, path, COPY_AGAIN) from error
        columns.append(rows)
    return columns


def _is_motion(path: Path) -> bool:
    return (path / CONTROL).is_file() and (path / STATE).is_file()


READER = LogReader("motion of isaac-sim2real/sage", (FOLDER,), _is_motion, read_sage)
