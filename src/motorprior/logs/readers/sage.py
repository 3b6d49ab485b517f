"""Motions of isaac-sim2real/sage, in the folders that its recorder writes.

A folder holds ``control.csv`` (timestamp, positions), ``state_motor.csv`` (timestamp, positions, velocities, torques)
and ``joint_list.txt``. Times are in µs; the values of all joints are one text ``"[0.1, 0.2]"``. A row of the log is a
row of states with the command in force. Torques are unsigned and not read. The shipped map `so101_sage` names the
joints.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_text
from motorprior.exceptions import LogError
from motorprior.logs.column_map import ColumnMap, MappedJoint, load_column_map
from motorprior.logs.log_reader import FOLDER, LogReader, read_mapped_log, robot_of_joints
from motorprior.logs.motor_log import MotorLog, bad_value, require_increasing
from motorprior.logs.readers.table import COPY_AGAIN, csv_table
from motorprior.robots.robot import Robot

CONTROL, STATE = "control.csv", "state_motor.csv"
MICROSECOND = 1e-6


def read_sage(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read the folder of one motion; ``robot`` gives the order of the joints if it has these joints."""
    names, columns = read_text(path / "joint_list.txt", LogError).split(), load_column_map("so101_sage")
    if set(names) != {joint.column for joint in columns.joints}:  # another robot
        joints = tuple(MappedJoint(name, name) for name in names)
        columns = replace(columns, robot="", motor="", firmware={}, joints=joints)

    def merged(path: Path, wanted: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
        since, (targets,) = _table(path / CONTROL, ["positions"], len(names))
        time, (angles, speeds) = _table(path / STATE, ["positions", "velocities"], len(names))
        require_increasing(MICROSECOND * since, path / CONTROL)
        begun = time >= since[0]
        in_force = np.searchsorted(since, time[begun], side="right") - 1
        series = {"q_des": targets[in_force], "q": angles[begun], "dq": speeds[begun]}
        found = {f"{kind}_{joint}": values[:, k] for kind, values in series.items() for k, joint in enumerate(names)}
        return {name: MICROSECOND * time[begun] if name == "t_s" else found[name] for name in wanted}

    return read_mapped_log(path, columns, merged, robot_of_joints(robot, tuple(each.name for each in columns.joints)))


READER = LogReader(
    "motion of isaac-sim2real/sage",
    (FOLDER,),
    lambda path: (path / CONTROL).is_file() and (path / STATE).is_file(),
    read_sage,
)


def _table(path: Path, lists: list[str], width: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times (T,) [µs] and each column of lists (T, width) of one file."""
    table = csv_table(path, ["timestamp", *lists], inferred=lists)
    return np.asarray(table.column("timestamp").to_numpy()), [
        np.array([_numbers(text, row, name, width, path) for row, text in enumerate(table.column(name).to_pylist())])
        for name in lists
    ]


def _numbers(text: str, row: int, name: str, width: int, path: Path) -> list[float]:
    """The numbers of a text ``[0.1, 0.2]``."""
    try:
        found = [float(value) for value in json.loads(text)]
    except (TypeError, ValueError) as error:
        raise bad_value(row, name, text, "a list of numbers", path, COPY_AGAIN) from error
    if len(found) != width:
        problem = f"row {row}, {name} has {len(found)} values for {width} joints"
        raise LogError(problem, where=path, remedy=COPY_AGAIN)
    return found
