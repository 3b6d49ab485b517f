"""Logs of a legged robot in the format of jietan/puppersim (Apache-2.0).

Two containers hold the same recordings: the original pickles (``.txt``: a dict of lists ``t``, ``IMU``, ``MotorAngle``,
``action``) and CSV, plain or gzip. Angles are in rad, time in s. The first two IMU columns are assumed to be roll and
pitch. The logs hold no velocity and no torque.
"""

from __future__ import annotations

import re
from pathlib import Path

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
PICKLE = ".txt"
_IMU = ("imu_roll", "imu_pitch", "imu_rate_roll", "imu_rate_pitch")
_LISTS = {"t": "t_s", "action": "q_des_{}", "MotorAngle": "q_{}", "IMU": "{}"}  # key of the pickle -> columns


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
    source = _pickle_columns if path.suffix == PICKLE else lambda path, names, columns: table_columns(path, names)
    return read_mapped_log(path, columns, source, robot)


def _pickle_columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    """The columns of the CSV, from an original pickle."""
    try:
        content, found = load_pickle(read_bytes(path, error=LogError), numpy_names()), {}
        for key, name in _LISTS.items():  # a list of T rows, or an array
            block = np.array([np.ravel(row) for row in content[key]], dtype=np.float64).reshape(len(content[key]), -1)
            places = _IMU if key == "IMU" else range(block.shape[1])
            found |= {name.format(place): column for place, column in zip(places, block.T, strict=False)}
    except LogError as error:
        raise LogError(error.problem, where=path, remedy=error.remedy) from error
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(f"not lists {', '.join(_LISTS)} of equal rows ({error})", where=path, remedy=GET_LOGS) from error
    if missing := [name for name in names if name not in found]:
        raise missing_column("list", missing[0], found, path, GET_LOGS)
    return {name: found[name] for name in names}


def short_name(path: Path) -> str | None:
    """``env_log_real_0116.csv.gz`` -> ``0116``; None if the file is not a log of the real robot."""
    found = re.fullmatch(r"env_(.+?)(\.csv\.gz|\.csv|\.txt)", path.name)
    words = found[1].split("_") if found else []
    return "_".join(word for word in words if word not in ("log", "real")) if "real" in words else None


READER = LogReader(
    "log of jietan/puppersim",
    (".csv.gz", ".csv", PICKLE),
    lambda path: path.suffix == PICKLE or {"t_s", *_IMU} <= {*csv_names(path)},
    lambda path, robot: read_puppersim_log(path, require_robot(robot, path)),
)
