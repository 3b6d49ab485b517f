"""Datasets of LeRobot (version 3: ``meta/info.json``, ``data/chunk-*/file-*.parquet``).

``action`` is the command and ``observation.state`` the angle: lists of one number per joint, in
degrees. Episodes become segments; info.json names joints and robot. The dataset does not contain
its units: recordings in other units, and grippers, which LeRobot records in per cent, need a column
map with ``scale``. The file lerobot_robots.toml holds the servo registers that LeRobot's driver
writes.
"""

import json
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_text
from motorprior.exceptions import LogError, quoted
from motorprior.logs.column_map import SCALES, ColumnMap, Conversion, MappedJoint
from motorprior.logs.log_reader import (
    FOLDER,
    GIVE_COLUMNS,
    LogReader,
    read_mapped_log,
    robot_of_joints,
)
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.table import table_columns
from motorprior.robots.robot import Robot

INFO = Path("meta") / "info.json"
ACTION = "action"
STATE = "observation.state"
_REMEDY = "give the folder of a LeRobot dataset of version 3 with action and observation.state"


def read_lerobot(path: Path, robot: Robot | None = None) -> MotorLog:
    """Read the folder of a dataset; a robot gives the order if it has these joints."""
    info = _info(path)
    names = _joint_names(info, ACTION, path)
    state_names = _joint_names(info, STATE, path)
    if names != state_names:
        problem = f"{ACTION} has {list(names)}, {STATE} has {list(state_names)}"
        raise LogError(
            problem[:400],
            where=path / INFO,
            remedy="give a dataset whose actions are joint positions",
        )

    robot_type = str(info.get("robot_type") or "")
    degree = Conversion(SCALES["angle"]["deg"])
    conversions = {"position_target": degree, "joint_pos": degree}
    joints = [
        MappedJoint(str(index), name, conversions=conversions) for index, name in enumerate(names)
    ]
    columns = ColumnMap(
        source=str(path / INFO),
        robot=robot_type,
        time="timestamp",
        segment="episode_index",
        joints=tuple(joints),
        series={"position_target": ACTION + "[{joint}]", "joint_pos": STATE + "[{joint}]"},
        firmware=_registers().get(robot_type, {}),
    )
    return read_mapped_log(path, columns, _columns, robot_of_joints(robot, names))


def _registers() -> dict[str, Any]:
    """Servo registers by type of robot."""
    file = files("motorprior.logs.readers") / "lerobot_robots.toml"
    return tomllib.loads(file.read_text("utf-8"))


def _columns(path: Path, names: list[str], columns: ColumnMap) -> dict[str, np.ndarray]:
    info = _info(path)
    data_files = sorted(path.glob("data/chunk-*/file-*.parquet"))
    if not data_files:
        raise LogError("no data/chunk-*/file-*.parquet", where=path, remedy=_REMEDY)

    tables = [table_columns(file, names, columns.time) for file in data_files]
    whole = {}
    for name in tables[0]:
        whole[name] = np.concatenate([table[name] for table in tables])

    rows = len(whole[names[0]])
    stated_rows = info.get("total_frames", rows)
    if stated_rows != rows:
        count = f"total_frames is {str(stated_rows)[:40]}"
        raise LogError(
            f"{count}, its data/chunk-*/file-*.parquet have {rows}",
            where=path / INFO,
            remedy="copy the dataset again with all its files",
        )
    return whole


def _is_dataset(path: Path) -> bool:
    return (path / INFO).is_file()


READER = LogReader(
    "dataset of LeRobot",
    (FOLDER,),
    _is_dataset,
    read_lerobot,
    _columns,
    assumption="a LeRobot dataset does not contain its units: angles are taken as degrees, also of "
    "the gripper, which LeRobot usually records in per cent; for other units give columns, a "
    "column map with scale (docs/your-motors.md)",
)


def _info(path: Path) -> dict[str, Any]:
    where = path / INFO
    try:
        info = json.loads(read_text(where, LogError))
    except (ValueError, RecursionError) as error:
        raise LogError(f"not JSON ({error})", where=where, remedy=_REMEDY) from error

    version = str(info.get("codebase_version")) if isinstance(info, dict) else ""
    if not version.startswith("v3."):
        raise LogError(
            f"codebase_version {quoted(version)}, not v3",
            where=where,
            remedy="convert version 2.1 with LeRobot's convert_dataset_v21_to_v30, and give the "
            "new folder",
        )
    return info


def _joint_names(info: dict[str, Any], feature: str, path: Path) -> tuple[str, ...]:
    """Names of the joints whose positions a feature holds."""
    try:
        names = info["features"][feature]["names"]
        if isinstance(names, dict):  # one group of motors
            (names,) = names.values()
        no_positions = [name for name in names if "." in name and not name.endswith(".pos")]
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(
            f"features lacks the names of {feature}", where=path / INFO, remedy=_REMEDY
        ) from error

    if no_positions:
        raise LogError(
            f"{feature} has {quoted(no_positions[0])}, which is not a position (.pos)",
            where=path / INFO,
            remedy=f"read the positions {GIVE_COLUMNS}",
            argument="columns",
        )
    return tuple(name.removesuffix(".pos") for name in names)
