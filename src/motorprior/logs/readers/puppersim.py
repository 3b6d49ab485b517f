"""Logs of a legged robot in the format of jietan/puppersim (Apache-2.0).

Two containers hold the same recordings: the original pickles (``.txt``: a dict of lists ``t``,
``IMU``, ``MotorAngle``, ``action``) and CSV, plain or gzip. Angles are in rad, time in s. The first
two IMU columns are assumed to be roll and pitch. The logs hold no velocity and no torque.
"""

from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.column_map import ColumnMap, MappedJoint
from motorprior.logs.log_reader import LogReader, read_mapped_log, require_robot
from motorprior.logs.motor_log import MotorLog, missing_column
from motorprior.logs.pickled_arrays import pickled_arrays
from motorprior.logs.readers.table import csv_names, table_columns
from motorprior.robots.robot import Robot

GET_LOGS = (
    "get them from the repository jietan/puppersim, folder puppersim/data/system_id (Apache-2.0)"
)
_IMU = ("imu_roll", "imu_pitch", "imu_rate_roll", "imu_rate_pitch")
# key of the pickle -> columns
_LISTS = {"t": "t_s", "action": "q_des_{}", "MotorAngle": "q_{}", "IMU": "{}"}


def read_puppersim_log(path: Path, robot: Robot | None) -> MotorLog:
    """Read one recording of ``robot``: ``.csv``, ``.csv.gz`` or the original pickle ``.txt``."""
    robot = require_robot(robot, path)
    columns = ColumnMap(
        source="jietan/puppersim",
        motor=robot.motor,
        time="t_s",
        base_orientation=_IMU[:2],
        series={"position_target": "q_des_{joint}", "joint_pos": "q_{joint}"},
        joints=tuple(MappedJoint(str(index), name) for index, name in enumerate(robot.joint_names)),
    )
    return read_mapped_log(path, columns, _columns, robot)


def _columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    if path.suffix != ".txt":
        return table_columns(path, names)
    values = _pickled_columns(path)
    for name in names:
        if name not in values:
            raise missing_column("list", name, values, path, GET_LOGS)
    return {name: values[name] for name in names}


def _pickled_columns(path: Path) -> dict[str, np.ndarray]:
    """All columns of a pickle, by the names of the columns of a CSV."""
    arrays = pickled_arrays(path)
    values = {}
    for key, column_name in _LISTS.items():
        if key not in arrays:
            problem = f"not lists {', '.join(_LISTS)} of equal rows ({key} is missing or uneven)"
            raise LogError(problem, where=path, remedy=GET_LOGS)
        table = arrays[key].astype(np.float64).reshape(len(arrays[key]), -1)
        labels = _IMU if key == "IMU" else range(table.shape[1])
        for label, column in zip(labels, table.T, strict=False):
            values[column_name.format(label)] = column
    return values


def _is_puppersim(path: Path) -> bool:
    return path.suffix == ".txt" or {"t_s", *_IMU} <= set(csv_names(path))


READER = LogReader(
    "log of jietan/puppersim",
    (".csv.gz", ".csv", ".txt"),
    _is_puppersim,
    read_puppersim_log,
    needs_robot=True,
)
