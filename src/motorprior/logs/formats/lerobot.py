"""Datasets of LeRobot (version 3: ``meta/info.json``, ``data/chunk-*/file-*.parquet``) become `MotorLog`s.

``action`` is the command and ``observation.state`` the angle, lists of one number per joint in degrees; episodes become
segments. Names of joints and robot are those of info.json. The dataset does not say its units: recordings that were not
made in degrees, and grippers, which LeRobot records in per cent, need a column map with their scales.
What its driver writes into the servos of a robot stands in lerobot_robots.toml.
"""

from __future__ import annotations

import json
import tomllib
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import is_number
from motorprior.exceptions import LogError, shown
from motorprior.files import read_text
from motorprior.logs.formats.column_map import ColumnMap, MappedJoint
from motorprior.logs.formats.column_units import ANGLES, Conversion
from motorprior.logs.formats.log_reader import FOLDER, LogReader
from motorprior.logs.formats.mapped_table import if_it_has, read_mapped_log
from motorprior.logs.formats.table_columns import table_columns
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

INFO = Path("meta") / "info.json"
ACTION, STATE, EPISODE = "action", "observation.state", "episode_index"
SUFFIX = ".pos"
MAX_INFO = 10_000_000
RATE_ERROR = 0.1
"""Relative difference between the stated and the recorded rate that passes."""
ROBOTS = files("motorprior.logs.formats").joinpath("lerobot_robots.toml")
"""Registers of the firmware by type of robot (`MotorLog.firmware`)."""
GRANTED = (
    "a LeRobot dataset does not say its units: all angles are taken as degrees, of the gripper, too, which LeRobot "
    "usually records in per cent of its range; say otherwise by a column map with scale (columns, docs/your-motors.md)"
)
CONVERT = (
    "convert it to version 3 with LeRobot's own scripts (convert_dataset_v21_to_v30 takes version 2.1), and give the "
    "new folder"
)
_REMEDY = "give the folder of a LeRobot dataset of version 3 with action and observation.state"


def is_lerobot_folder(path: Path) -> bool:
    """Whether a folder has a description of a dataset."""
    return (path / INFO).is_file()


def read_lerobot(path: str | Path, robot: Robot | None = None) -> MotorLog:
    """Read a dataset, every episode a segment.

    Args:
        path: the folder that holds ``meta`` and ``data``.
        robot: the log has its joints' order if these joints are its own.

    Raises:
        LogError: a file that is missing or damaged, a description that does not fit its data, as of another number of
            joints, frames or episodes, or of what is no position, a rate that is another than the stated one; names the
            file, the key and the value.
    """
    path = Path(path)
    info = _info(path)
    names = _names(info, path)
    kind = str(info.get("robot_type") or "")
    degree = Conversion(ANGLES["deg"])
    units = {"position_target": degree, "joint_pos": degree}
    joints = tuple(MappedJoint(str(k), name, conversions=units) for k, name in enumerate(names))
    columns = ColumnMap(
        source=str(path / INFO), motor="", robot=kind, time="timestamp", segment=EPISODE, joints=joints,
        series={"position_target": ACTION + "[{joint}]", "joint_pos": STATE + "[{joint}]"},
        firmware=tomllib.loads(ROBOTS.read_text("utf-8")).get(kind, {}),
    )  # fmt: skip
    log = read_mapped_log(path, columns, if_it_has(robot, names), partial(lerobot_columns, joints=len(names)))
    _require_rate(log, info, path)
    return log


LEROBOT = LogReader("dataset of LeRobot", (FOLDER,), is_lerobot_folder, read_lerobot, GRANTED)


def lerobot_files(path: Path) -> list[Path]:
    """All that is read of a dataset: its description and its tables, no videos or images."""
    return [path / INFO, *_tables(path)]


def _tables(path: Path) -> list[Path]:
    return sorted(path.glob("data/chunk-*/file-*.parquet"))


def lerobot_columns(
    path: Path, names: list[str], joints: int | None = None, posture: str | None = None
) -> dict[str, np.ndarray]:
    """Columns of a dataset's files, see `table_columns`.

    Args:
        path: the folder of the dataset.
        names: of columns, or of elements of columns of lists.
        joints: numbers that ACTION and STATE have to have in every row; as many as there are if not given.
        posture: that of the columns which holds names of postures.

    Raises:
        LogError: no files, files with another number of frames or episodes than the description says, or as
            `table_columns`.
    """
    info, found = _info(path), _tables(path)
    if not found:
        raise LogError("no data/chunk-*/file-*.parquet", where=path, remedy=_REMEDY)
    lengths: dict[str, int] | None = dict.fromkeys((ACTION, STATE), joints) if joints else None
    parts = [table_columns(file, names, lengths=lengths, posture=posture) for file in found]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    _require_complete(info, "frames", len(next(iter(columns.values()))), path)
    if EPISODE in columns:
        _require_complete(info, "episodes", len(np.unique(columns[EPISODE])), path)
    return columns


def _require_complete(info: dict[str, Any], what: str, count: int, path: Path) -> None:
    """Refuse a dataset of which files are missing, where its description says how many rows and episodes it has."""
    stated = info.get(f"total_{what}")
    if stated is not None and stated != count:
        problem = f"total_{what} is {str(stated)[:40]}, its data/chunk-*/file-*.parquet have {count}"
        remedy = "copy the dataset again with all its files, or correct the number"
        raise LogError(problem, where=path / INFO, remedy=remedy)


def _info(path: Path) -> dict[str, Any]:
    where = path / INFO
    try:
        info = json.loads(read_text(where, MAX_INFO, LogError))
    except (ValueError, RecursionError) as error:
        raise LogError(f"not JSON ({error})", where=where, remedy=_REMEDY) from error
    version = info.get("codebase_version") if isinstance(info, dict) else None
    if not isinstance(version, str) or not version.startswith("v3."):
        old = isinstance(version, str) and version.startswith("v2.")
        problem = f"codebase_version {str(version)[:40]!r}, not v3"
        raise LogError(problem, where=where, remedy=CONVERT if old else _REMEDY)
    return info


def _names(info: dict[str, Any], path: Path) -> tuple[str, ...]:
    """Names of the joints, which the command and the angle must share."""
    action, state = (_feature_names(info, feature, path) for feature in (ACTION, STATE))
    if action != state:
        problem = f"{ACTION} is of {list(action)}, {STATE} of {list(state)}"
        raise LogError(problem[:400], where=path / INFO, remedy="give a dataset whose actions are joint positions")
    return action


def _feature_names(info: dict[str, Any], feature: str, path: Path) -> tuple[str, ...]:
    features = info.get("features")
    known = features.get(feature) if isinstance(features, dict) else None
    names = known.get("names") if isinstance(known, dict) else None
    if isinstance(names, dict) and len(names) == 1:
        (names,) = names.values()
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise LogError(f"features lacks the names of {feature}", where=path / INFO, remedy=_REMEDY)
    if odd := [name for name in names if "." in name and not name.endswith(SUFFIX)]:
        problem = f"{feature} has {shown(odd[0])}, which is no position ({SUFFIX})"
        remedy = "name the joints whose angles to take by a column map (columns, docs/your-motors.md)"
        raise LogError(problem, where=path / INFO, remedy=remedy, argument="columns")
    return tuple(name.removesuffix(SUFFIX) for name in names)


def _require_rate(log: MotorLog, info: dict[str, Any], path: Path) -> None:
    recorded, stated = 1.0 / log.period, info.get("fps")
    if not is_number(stated, (1.0 - RATE_ERROR) * recorded, (1.0 + RATE_ERROR) * recorded):
        problem = f"fps is {str(stated)[:40]}, its timestamps say {recorded:.4g}"
        raise LogError(problem, where=path / INFO, remedy="correct fps or the timestamps")
