"""Logs of a legged robot in the format of jietan/puppersim (Apache-2.0).

Two containers hold the same recordings: the original pickles (``.txt``: a dict of lists ``t``, ``IMU``, ``MotorAngle``,
``action``) and CSV, plain or gzip. Angles are in rad, time in s.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, listed
from motorprior.files import load_pickle, numpy_names, read_bytes
from motorprior.logs.doctor.units import require_plausible_angles
from motorprior.logs.formats.csv_table import csv_head, read_number_table
from motorprior.logs.formats.log_reader import GIVE_COLUMNS, LogReader, require_robot
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

GET_LOGS = "get them from the repository jietan/puppersim, folder puppersim/data/system_id (Apache-2.0)"
CSV_SUFFIXES = (".csv.gz", ".csv")
PICKLE_SUFFIX = ".txt"
MAX_PICKLE = 100_000_000
_IMU = ("imu_roll", "imu_pitch", "imu_rate_roll", "imu_rate_pitch")
_COLUMN = re.compile(rf"t_s|q(_des)?_\d+|{'|'.join(_IMU)}", re.ASCII)
_NUMBER = re.compile(r"[-+.,\d]*(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)


def csv_columns(num_joints: int) -> tuple[str, ...]:
    """Column names: time, targets, angles, IMU."""
    targets, angles = (tuple(f"{name}_{joint}" for joint in range(num_joints)) for name in ("q_des", "q"))
    return ("t_s", *targets, *angles, *_IMU)


def read_puppersim_log(path: str | Path, robot: Robot) -> MotorLog:
    """Read one recording of ``robot``: ``.csv``, ``.csv.gz`` or the original pickle ``.txt``.

    The first two IMU columns are assumed to be roll and pitch. The logs hold no velocity and no torque.

    Raises:
        LogError: wrong columns, truncated, not numbers, not finite, or time that does not increase; names file, row,
            column and value.
    """
    path, joints = Path(path), robot.num_joints
    if path.name.endswith(PICKLE_SUFFIX):
        table = _pickle_table(path, {"t": 1, "action": joints, "MotorAngle": joints, "IMU": len(_IMU)})
    else:
        table = read_number_table(path, csv_columns(joints))
    time, position_target, joint_pos, imu = np.split(table, [1, 1 + joints, 1 + 2 * joints], axis=1)
    log = MotorLog(
        time=time[:, 0], position_target=position_target, joint_pos=joint_pos, base_orientation=imu[:, :2],
        joint_names=robot.joint_names, robot=robot.name, motor=robot.motor, source=str(path), encoder=robot.encoder,
    )  # fmt: skip
    return checked(log, where=path)


def read_puppersim_logs(directory: str | Path, robot: Robot) -> dict[str, MotorLog]:
    """Read every recording of a real robot in a folder, by short name: ``0116``, ``bf``, ``lr``, ``1_joint``.

    Raises:
        LogError: no such folder, no log in it, two files of one name, or a log that cannot be read or whose angles are
            implausible.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise LogError("no such folder", where=directory, remedy=GET_LOGS)
    paths: dict[str, Path] = {}
    for path in sorted(directory.iterdir()):
        if (name := short_name(path)) is None:
            continue
        if name in paths:
            problem = f"{paths[name].name} and {path.name} are both log {name!r}"
            raise LogError(problem, where=directory, remedy="keep one")
        paths[name] = path
    if not paths:
        raise LogError("no log of a real robot (env_*real_*) in this folder", where=directory, remedy=GET_LOGS)
    logs = {name: read_puppersim_log(path, robot) for name, path in paths.items()}
    for name, log in logs.items():
        require_plausible_angles(log, paths[name])
    return logs


def short_name(path: Path) -> str | None:
    """``env_log_real_0116.csv.gz`` -> ``0116``; None if the file is not a log of the real robot."""
    suffix = next((end for end in (*CSV_SUFFIXES, PICKLE_SUFFIX) if path.name.endswith(end)), None)
    if suffix is None or not path.is_file():
        return None
    words = path.name.removesuffix(suffix).split("_")
    if words[0] != "env" or "real" not in words:
        return None
    return "_".join(word for word in words[1:] if word not in ("log", "real")) or None


def _pickle_table(path: Path, widths: dict[str, int]) -> np.ndarray:
    """The columns of the CSV, (T, 1 + 2·J + 4), from an original pickle with lists of these widths."""
    try:
        content = load_pickle(read_bytes(path, MAX_PICKLE, LogError), numpy_names())
    except LogError as error:
        raise LogError(error.problem, where=path, remedy=error.remedy) from error
    if not isinstance(content, dict) or not widths.keys() <= content.keys():
        raise LogError(f"expected a dict of {list(widths)}", where=path, remedy=GET_LOGS)
    columns = [_column_block(content[key], key, width, path) for key, width in widths.items()]
    if len({len(block) for block in columns}) != 1:
        raise LogError(f"lists of unequal length {[len(block) for block in columns]}", where=path, remedy=GET_LOGS)
    return np.concatenate(columns, axis=1)


def _column_block(rows: Any, key: str, width: int, path: Path) -> np.ndarray:
    """A list of T rows, or an array, as (T, width)."""
    if not isinstance(rows, list | tuple | np.ndarray):
        raise LogError(f"{key} is {type(rows).__name__}, not a list", where=path, remedy=GET_LOGS)
    block = np.empty((len(rows), width))
    for index, row in enumerate(rows):
        try:
            block[index] = np.ravel(row).reshape(width)
        except (TypeError, ValueError):
            problem = f"row {index}, {key} is {str(row)[:80]}, not {width} numbers"
            raise LogError(problem, where=path, remedy=GET_LOGS) from None
    return block


def _read(path: Path, robot: Robot | None) -> MotorLog:
    if path.name.endswith(CSV_SUFFIXES):
        names = csv_head(path).names
        # a third-party table is not a damaged log of this format
        if 2 * sum(_COLUMN.fullmatch(name) is not None for name in names) < len(names):
            found = listed(list(map(ascii, names)), 8)[:200]
            if all(_NUMBER.fullmatch(name) for name in names):
                raise LogError(f"no header: its first line is {found}", where=path, remedy="begin it with names")
            problem = f"a table of unknown format; its first line is {found}"
            raise LogError(problem, where=path, remedy=f"read it {GIVE_COLUMNS}", argument="columns")
    return read_puppersim_log(path, require_robot(robot, path))


PUPPERSIM = LogReader("log of jietan/puppersim", (*CSV_SUFFIXES, PICKLE_SUFFIX), lambda path: True, _read)
