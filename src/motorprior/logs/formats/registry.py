"""All log formats. A new one is a file with its `LogReader`, and an entry in READERS."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from motorprior.exceptions import ConfigError, LogError, quoted
from motorprior.logs.formats.bag_columns import bag_columns
from motorprior.logs.formats.bag_messages import is_bag
from motorprior.logs.formats.bam import BAM
from motorprior.logs.formats.column_map import ColumnMap, load_column_map, shipped_maps
from motorprior.logs.formats.lerobot import LEROBOT, is_lerobot_folder, lerobot_columns
from motorprior.logs.formats.log_reader import GIVE_COLUMNS, LogReader
from motorprior.logs.formats.mapped_table import Columns, read_mapped_log
from motorprior.logs.formats.parquet_io import PARQUET
from motorprior.logs.formats.puppersim import PUPPERSIM
from motorprior.logs.formats.robot_run import ROBOT_RUN
from motorprior.logs.formats.ros_bag import ROS_BAG
from motorprior.logs.formats.sage import SAGE
from motorprior.logs.formats.table_columns import POSTURE_NAMES, table_columns
from motorprior.logs.formats.tensor_file import describe_tensors, tensor_columns
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

READERS: tuple[LogReader, ...] = (PARQUET, ROBOT_RUN, PUPPERSIM, BAM, SAGE, LEROBOT, ROS_BAG)  # tried in this order
TABLES = (".csv", ".csv.gz", ".parquet", ".pt", ".mcap")  # endings of files that can be read with a column map


def read_log(path: str | Path, robot: Robot | None = None, columns: ColumnMap | str | Path | None = None) -> MotorLog:
    """Read a log in any format of docs/logs.md, or any table by a map of its columns.

    Args:
        path: the file, or the folder for formats that are folders.
        robot: the recorded robot; not needed for formats that name their joints.
        columns: a column map, the name of a shipped one, or its file (docs/your-motors.md): for a table (.csv, .csv.gz,
            .parquet), the folder of a LeRobot dataset, the tensors of a .pt or the topics of a ROS 2 bag.

    Returns:
        The log in SI units, checked for shape, order and finite numbers; `check_log` checks its quality.

    Raises:
        LogError: no such file, an unknown format, or a damaged file; names row and column.
        ConfigError: the format needs a robot, or the map is for another one.
        ArtifactError: a bad column map.
    """
    path = Path(path)
    if columns is not None:
        column_map = columns if isinstance(columns, ColumnMap) else load_column_map(columns)
        if robot is not None and column_map.robot not in ("", robot.name):
            raise ConfigError(
                f"robot {robot.name!r}, but the column map {column_map.source} is for {column_map.robot!r}", where=path,
                remedy=f"give {column_map.robot!r} as robot, or correct robot in the map", argument="robot",
            )  # fmt: skip
        return read_mapped_log(path, column_map, _source(path, column_map), robot)
    for reader in READERS:
        if reader.matches(path):
            return reader.read(path, robot)
    if not path.exists():
        raise LogError("no such file", where=path, remedy="check the path")
    if path.is_dir():
        raise _not_a_log(path)
    if path.suffix == ".pt":
        maps = ", ".join(name for name in shipped_maps() if name.endswith("_tensors"))
        problem = f"unmapped tensors: {describe_tensors(path)}"
        remedy = f"read it {GIVE_COLUMNS}, or a shipped map: {maps}"
        raise LogError(problem, where=path, remedy=remedy, argument="columns")
    formats = "; ".join(f"{reader.name} ({', '.join(reader.endings)})" for reader in READERS)
    remedy = f"give one of: {formats}; or read a table or tensors {GIVE_COLUMNS}"
    raise LogError("unknown log format", where=path, remedy=remedy, argument="columns")


def recording_name(path: Path) -> str:
    """File name without the format's ending, run.1.csv.gz -> run.1."""
    name = path.absolute().name
    return name.removesuffix(_ending(name)) or name


def unit_assumption(path: Path, columns: ColumnMap | str | Path | None = None) -> str:
    """A sentence about what `read_log` assumes because the format does not contain it; empty if nothing.

    Raises:
        LogError: the log cannot be read.
    """
    reader = next((reader for reader in READERS if reader.matches(path)), None) if columns is None else None
    return reader.assumption if reader else ""


def _ending(name: str) -> str:
    """The format's ending of a file's name, or empty."""
    endings = {*TABLES, *(ending for reader in READERS for ending in reader.endings)}
    return max((ending for ending in endings if name.endswith(ending)), key=len, default="")


def _not_a_log(folder: Path) -> LogError:
    endings = sorted({ending for file in folder.iterdir() if (ending := _ending(file.name)) and file.is_file()})
    patterns = " ".join(str(folder / f"*{ending}") for ending in endings)
    remedy = f"give its files: {patterns}" if endings else "give a log (docs/logs.md)"
    return LogError("a folder that is not a log", where=folder, remedy=remedy)


def _source(path: Path, columns: ColumnMap) -> Columns:
    """The function that reads the columns of a path.

    Raises:
        LogError: an unknown kind of folder, or a column of postures in a file without text.
    """
    if is_lerobot_folder(path):
        return partial(lerobot_columns, posture=columns.posture_column)
    if path.is_dir() and not is_bag(path):
        raise _not_a_log(path)
    if not is_bag(path) and path.suffix != ".pt":
        return partial(table_columns, time=columns.time, posture=columns.posture_column)
    if columns.posture_column:
        problem = f"posture = {quoted(columns.posture_column)} in {columns.source}: bags and .pt have no text columns"
        raise LogError(problem, where=path, remedy=f"give one posture for all rows: {POSTURE_NAMES}")
    if path.suffix == ".pt":
        return tensor_columns
    return partial(bag_columns, row_column=columns.columns_of("joint_pos", columns.joints)[0])
