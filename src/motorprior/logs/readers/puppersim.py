"""Logs of a legged robot in the format of jietan/puppersim (Apache-2.0).

Two containers hold the same recordings: the original pickles (``.txt``: a dict of lists ``t``, ``IMU``, ``MotorAngle``,
``action``) and CSV, plain or gzip. Angles are in rad, time in s. The first two IMU columns are assumed to be roll and
pitch. The logs hold no velocity and no torque.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.files import load_pickle, numpy_names, read_bytes
from motorprior.logs.column_map import ColumnMap, MappedJoint
from motorprior.logs.log_reader import LogReader, read_mapped_log, require_robot
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.tables import csv_names, table_columns
from motorprior.logs.validity import missing_column
from motorprior.robots.robot import Robot

GET_LOGS = "get them from the repository jietan/puppersim, folder puppersim/data/system_id (Apache-2.0)"
CSV_SUFFIXES = (".csv.gz", ".csv")
PICKLE_SUFFIX = ".txt"
MAX_PICKLE = 100_000_000
_IMU = ("imu_roll", "imu_pitch", "imu_rate_roll", "imu_rate_pitch")
_COLUMN = re.compile(rf"t_s|q(_des)?_\d+|{'|'.join(_IMU)}", re.ASCII)
_LISTS = {"t": "t_s", "action": "q_des", "MotorAngle": "q", "IMU": "imu"}  # key of the pickle -> columns


def csv_columns(num_joints: int) -> tuple[str, ...]:
    """Column names: time, targets, angles, IMU."""
    targets, angles = (tuple(f"{name}_{joint}" for joint in range(num_joints)) for name in ("q_des", "q"))
    return ("t_s", *targets, *angles, *_IMU)


def read_puppersim_log(path: Path, robot: Robot) -> MotorLog:
    """Read one recording of ``robot``: ``.csv``, ``.csv.gz`` or the original pickle ``.txt``.

    Raises:
        LogError: wrong columns, truncated, not numbers, not finite, or time that does not increase; names file, row,
            column and value.
    """
    columns = ColumnMap(
        source="jietan/puppersim", motor=robot.motor, time="t_s", base_orientation=_IMU[:2],
        series={"position_target": "q_des_{joint}", "joint_pos": "q_{joint}"},
        joints=tuple(MappedJoint(str(index), name) for index, name in enumerate(robot.joint_names)),
    )  # fmt: skip
    is_pickle = path.name.endswith(PICKLE_SUFFIX)
    return read_mapped_log(path, columns, _pickle_columns if is_pickle else _csv_columns, robot)


def _csv_columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    return table_columns(path, names)


def _pickle_columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """The columns of the CSV, from an original pickle."""
    try:
        content = load_pickle(read_bytes(path, MAX_PICKLE, LogError), numpy_names())
    except LogError as error:
        raise LogError(error.problem, where=path, remedy=error.remedy) from error
    if not isinstance(content, dict) or not _LISTS.keys() <= content.keys():
        raise LogError(f"expected a dict of {list(_LISTS)}", where=path, remedy=GET_LOGS)
    found = {name: column for key in _LISTS for name, column in _listed(content[key], key, path).items()}
    for name in names:
        if name not in found:
            raise missing_column("list", name, found, path, GET_LOGS)
    return {name: found[name] for name in names}


def _listed(rows: Any, key: str, path: Path) -> dict[str, np.ndarray]:
    """The columns of a list of T rows, or of an array."""
    try:
        block = np.array([np.ravel(row) for row in rows], dtype=np.float64).reshape(len(rows), -1)
    except (TypeError, ValueError) as error:
        raise LogError(f"{key} is not a list of equally long rows", where=path, remedy=GET_LOGS) from error
    if key in ("t", "IMU"):
        return dict(zip(("t_s",) if key == "t" else _IMU, block.T, strict=False))
    return {f"{_LISTS[key]}_{index}": column for index, column in enumerate(block.T)}


def short_name(path: Path) -> str | None:
    """``env_log_real_0116.csv.gz`` -> ``0116``; None if the file is not a log of the real robot."""
    found = re.fullmatch(r"env_(.+?)(\.csv\.gz|\.csv|\.txt)", path.name)
    words = found[1].split("_") if found else []
    return "_".join(word for word in words if word not in ("log", "real")) if "real" in words else None


def _recognises(path: Path) -> bool:
    if path.name.endswith(PICKLE_SUFFIX):
        return True
    names = csv_names(path)
    return 2 * sum(_COLUMN.fullmatch(name) is not None for name in names) >= len(names)


READER = LogReader(
    "log of jietan/puppersim",
    (*CSV_SUFFIXES, PICKLE_SUFFIX),
    _recognises,
    lambda path, robot: read_puppersim_log(path, require_robot(robot, path)),
)
