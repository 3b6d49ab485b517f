"""Read a log in any format. A new format is a file in `logs.readers` with its `LogReader` as READER."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from motorprior.exceptions import ConfigError, LogError
from motorprior.logs import readers
from motorprior.logs.column_map import ColumnMap, load_column_map, shipped_maps
from motorprior.logs.log_reader import GIVE_COLUMNS, LogReader, read_mapped_log
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot


def find_readers() -> tuple[LogReader, ...]:
    """The READER of every module in `logs.readers`."""
    return tuple(import_module(f"{readers.__name__}.{module.name}").READER for module in iter_modules(readers.__path__))


READERS = find_readers()


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
    path, reader = Path(path), reader_of(Path(path), columns is not None)
    if columns is None:
        assert reader.read is not None
        return reader.read(path, robot)
    column_map = columns if isinstance(columns, ColumnMap) else load_column_map(columns)
    if robot is not None and column_map.robot not in ("", robot.name):
        problem = f"robot {robot.name!r}, but the column map {column_map.source} is for {column_map.robot!r}"
        remedy = f"give {column_map.robot!r} as robot, or correct robot in the map"
        raise ConfigError(problem, where=path, remedy=remedy, argument="robot")
    assert reader.columns is not None
    return read_mapped_log(path, column_map, reader.columns, robot)


def reader_of(path: Path, with_columns: bool = False) -> LogReader:
    """The reader of a path, with or without a column map.

    Raises:
        LogError: no such path, an unknown format, or one that needs a map; says what would help.
    """
    if not path.exists():
        raise LogError("no such file", where=path, remedy="check the path")
    for reader in READERS:
        if (reader.columns if with_columns else reader.read) is not None and reader.matches(path):
            return reader
    if path.is_dir():
        endings = sorted({ending for file in path.iterdir() if (ending := _ending(file.name)) and file.is_file()})
        patterns = " ".join(str(path / f"*{ending}") for ending in endings)
        remedy = f"give its files: {patterns}" if endings else "give a log (docs/logs.md)"
        raise LogError("a folder that is not a log", where=path, remedy=remedy)
    for reader in READERS:
        if reader.columns is not None and reader.matches(path):
            remedy = f"read it {GIVE_COLUMNS}, or a shipped map: {', '.join(shipped_maps())}"
            raise LogError(reader.unmapped(path), where=path, remedy=remedy, argument="columns")
    formats = "; ".join(f"{reader.name} ({', '.join(reader.endings)})" for reader in READERS)
    raise LogError("unknown log format", where=path, remedy=f"give one of: {formats}", argument="columns")


def recording_name(path: Path) -> str:
    """File name without the format's ending, run.1.csv.gz -> run.1."""
    name = path.absolute().name
    return name.removesuffix(_ending(name)) or name


def _ending(name: str) -> str:
    """The format's ending of a file's name, or empty."""
    endings = {ending for reader in READERS for ending in reader.endings}
    return max((ending for ending in endings if name.endswith(ending)), key=len, default="")
