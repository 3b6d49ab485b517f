"""Every log format that can be read: a new one is a file with its `LogReader`, and a line here."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.formats.bag_columns import bag_columns
from motorprior.logs.formats.bag_messages import is_bag
from motorprior.logs.formats.bam import BAM
from motorprior.logs.formats.column_map import ColumnMap, load_column_map, shipped_maps
from motorprior.logs.formats.lerobot import LEROBOT, is_lerobot_folder, lerobot_columns
from motorprior.logs.formats.log_reader import SAY_COLUMNS, LogReader
from motorprior.logs.formats.mapped_table import Columns, read_mapped_log, require_one_posture
from motorprior.logs.formats.parquet_io import PARQUET
from motorprior.logs.formats.puppersim import PUPPERSIM
from motorprior.logs.formats.robot_run import ROBOT_RUN
from motorprior.logs.formats.ros_bag import ROS_BAG
from motorprior.logs.formats.sage import SAGE
from motorprior.logs.formats.tensor_file import describe_tensors
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

READERS: tuple[LogReader, ...] = (PARQUET, ROBOT_RUN, PUPPERSIM, BAM, SAGE, LEROBOT, ROS_BAG)
"""In the order in which they are asked."""


TABLES = (".csv", ".csv.gz", ".parquet", ".pt", ".mcap")
"""Endings of files that a column map can be for."""
OF_TENSORS = "_tensors"
"""How the names of shipped maps for files of tensors end."""


def read_log(path: str | Path, robot: Robot | None = None, columns: ColumnMap | str | Path | None = None) -> MotorLog:
    """Read a log in any known format (docs/logs.md), or any table by a map of its columns.

    Args:
        path: the file, or the folder of a format that is one.
        robot: that was recorded; formats that name their joints need none.
        columns: what the columns of a table of somebody else (.csv, .csv.gz, .parquet), of a LeRobot dataset's folder,
            the tensors of a .pt, or the topics of a ROS 2 bag mean: a map, the name of a shipped one, or its file
            (docs/your-motors.md).

    Returns:
        The log in SI units, checked for shape, order and finite numbers; `check_log` says whether it is any good.

    Raises:
        LogError: no such file, an unknown format, or a damaged file; names row and column.
        ConfigError: the format needs a robot and none was given, or the map is of another one.
        ArtifactError: a column map that cannot be used.
    """
    path = Path(path)
    if columns is not None:
        known = columns if isinstance(columns, ColumnMap) else load_column_map(columns)
        _require_same_robot(known, robot, path)
        return read_mapped_log(path, known, robot, _source(path, known))
    for reader in READERS:
        if reader.takes(path):
            return reader.read(path, robot)
    if not path.exists():
        raise LogError("no such file", where=path, remedy="check the path")
    if path.suffix == ".pt":
        raise _tensors_without_map(path)
    if path.is_dir():
        raise LogError("a folder, and no log by itself", where=path, remedy=_files_to_give(path))
    known = "; ".join(f"{reader.name} ({', '.join(reader.endings)})" for reader in READERS)
    remedy = f"give one of: {known}; or columns, what the names in a table or of tensors mean"
    raise LogError("not a log that can be read", where=path, remedy=remedy, argument="columns")


def recording_name(path: Path) -> str:
    """The name of a recording: that of its file without the format's ending, run.1.csv.gz -> run.1."""
    name = path.absolute().name
    return name.removesuffix(_ending(name)) or name


def _ending(name: str) -> str:
    """The format's ending of a file's name, empty if it has none."""
    known = {*TABLES, *(ending for reader in READERS for ending in reader.endings)}
    return max((ending for ending in known if name.endswith(ending)), key=len, default="")


def _files_to_give(folder: Path) -> str:
    """What to give in place of a folder: patterns for the files in it that may be logs."""
    endings = sorted({ending for file in folder.iterdir() if (ending := _ending(file.name)) and file.is_file()})
    patterns = " ".join(str(folder / f"*{ending}") for ending in endings)
    return f"give its files: {patterns}" if endings else "give a log; it holds none by the endings of docs/logs.md"


def taken_for_granted(path: Path, columns: ColumnMap | str | Path | None = None) -> str:
    """A sentence for the user: what `read_log` takes for granted of a log that does not say it; empty if nothing.

    Raises:
        LogError: the log cannot be read.
    """
    reader = next((reader for reader in READERS if reader.takes(path)), None) if columns is None else None
    return reader.taken_for_granted if reader else ""


def _tensors_without_map(path: Path) -> LogError:
    maps = ", ".join(name for name in shipped_maps() if name.endswith(OF_TENSORS))
    problem = f"unmapped tensors: {describe_tensors(path)}"
    remedy = f"read it {SAY_COLUMNS}, or a shipped map: {maps}"
    return LogError(problem, where=path, remedy=remedy, argument="columns")


def _source(path: Path, columns: ColumnMap) -> Columns | None:
    """What reads the columns of a path that is no table by its ending; None for one that is.

    Raises:
        LogError: a folder of none that is known.
    """
    if is_lerobot_folder(path):
        return partial(lerobot_columns, posture=columns.posture_column)
    if is_bag(path):
        require_one_posture(columns, path, "a bag")
        return partial(bag_columns, rows=columns.columns_of("joint_pos", columns.joints)[0])
    if path.is_dir():
        raise LogError("a folder, not a table", where=path, remedy=_files_to_give(path))
    return None


def _require_same_robot(columns: ColumnMap, robot: Robot | None, path: Path) -> None:
    if robot is not None and columns.robot not in ("", robot.name):
        raise ConfigError(
            f"robot {robot.name!r}, and the column map {columns.source} is of {columns.robot!r}", where=path,
            remedy=f"give {columns.robot!r} as robot, or correct robot in the map", argument="robot",
        )  # fmt: skip
