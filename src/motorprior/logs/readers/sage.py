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
    """Read the folder of one motion; ``robot`` gives the order of the joints if it has these joints."""
    names = read_text(path / "joint_list.txt", LogError).split()
    columns = load_column_map("so101_sage")
    if set(names) != {joint.column for joint in columns.joints}:  # another robot
        joints = tuple(MappedJoint(name, name) for name in names)
        columns = replace(columns, robot="", motor="", firmware={}, joints=joints)

    def merged(path: Path, wanted: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
        since, targets = _table(path / CONTROL, ["positions"], len(names))
        time, *measured = _table(path / STATE, ["positions", "velocities"], len(names))
        require_increasing(since, path / CONTROL)
        begun = time >= since[0]
        targets = targets[np.searchsorted(since, time[begun], side="right") - 1]  # in force
        found = {"t_s": time[begun]}
        for kind, values in zip(
            ("q_des", "q", "dq"), (targets, *(each[begun] for each in measured)), strict=True
        ):
            found |= {
                f"{kind}_{joint}": column for joint, column in zip(names, values.T, strict=True)
            }
        return {name: found[name] for name in wanted}

    return read_mapped_log(
        path, columns, merged, robot_of_joints(robot, tuple(each.name for each in columns.joints))
    )


def _table(path: Path, lists: list[str], width: int) -> list[np.ndarray]:
    """Times (T,) [s] of one file, and each of its columns of texts ``[0.1, 0.2]`` as (T, width)."""
    table = csv_table(path, ["timestamp", *lists], inferred=lists)
    found = [MICROSECOND * table.column("timestamp").to_numpy()]
    for name in lists:
        rows = np.empty((table.num_rows, width))
        for row, text in enumerate(table.column(name).to_pylist()):
            try:
                rows[row] = np.reshape(json.loads(text), width)
            except (TypeError, ValueError) as error:
                raise bad_value(
                    row, name, text, f"a list of {width} numbers", path, COPY_AGAIN
                ) from error
        found.append(rows)
    return found


READER = LogReader(
    "motion of isaac-sim2real/sage",
    (FOLDER,),
    lambda path: (path / CONTROL).is_file() and (path / STATE).is_file(),
    read_sage,
)
