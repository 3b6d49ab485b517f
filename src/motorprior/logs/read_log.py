"""Read a log in any format, or every log of a folder. `load_log.load_log` also prepares it.

A new format is a file in `logs.readers` with its `LogReader` as READER.
"""

import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from motorprior.exceptions import ConfigError, LogError, MotorPriorError
from motorprior.logs import readers
from motorprior.logs.column_map import GAINS, ColumnMap, load_column_map, shipped_maps
from motorprior.logs.log_reader import (
    GIVE_COLUMNS,
    LogReader,
    gain_contradictions,
    read_mapped_log,
    unmapped_gains,
)
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

READERS: tuple[LogReader, ...] = tuple(
    import_module(f"{readers.__name__}.{module.name}").READER
    for module in iter_modules(readers.__path__)
)


@dataclass(frozen=True)
class Recording:
    """A log as its reader returns it, before `prepare_log`."""

    log: MotorLog
    path: Path  # named in notes and errors
    # its reader has put it on the grid, since the format has more information than its rows
    is_on_grid: bool = False
    # a sentence for the user about what the reader assumes, since the format lacks it
    assumption: str = ""
    warnings: tuple[str, ...] = ()  # contradictions of the file and its column map


def read_log(
    path: str | Path, robot: Robot | None = None, columns: ColumnMap | str | Path | None = None
) -> MotorLog:
    """Read a log in any format of docs/logs.md, or any table by a map of its columns.

    Args:
        path: the file, or the folder for formats that are folders.
        robot: the recorded robot; not needed for formats that name their joints.
        columns: a column map, the name of a shipped one, or its file (docs/your-motors.md): for a
            table (.csv, .csv.gz, .parquet), the folder of a LeRobot dataset, the tensors of a .pt
            or the topics of a ROS 2 bag.

    Returns:
        The recorded rows in SI units, checked for shape, order and finite numbers; `check_log`
        checks their quality.

    Raises:
        LogError: no such file, an unknown format, or a damaged file; names row and column.
        ConfigError: the format needs a robot, or the map is for another one.
        ArtifactError: a bad column map.
    """
    return read_recording(Path(path), robot, columns).log


def read_recording(
    path: Path,
    robot: Robot | None = None,
    columns: ColumnMap | str | Path | None = None,
    period: float | None = None,
    suspended: bool = False,
) -> Recording:
    """Read a log for `prepare_log`; arguments and errors as `read_log`.

    A ``period`` [s] is for formats that have more information than their rows: their readers put
    the log on the grid. ``suspended`` selects the activities of a robot that such a log contains.
    """
    reader = reader_of(path, columns is not None)
    if columns is not None:
        column_map = load_column_map(columns).of_robot(robot)
        log = _read_mapped(path, reader, column_map, robot)
        warnings = gain_contradictions(log, column_map)
        if not set(GAINS) <= column_map.series.keys():
            warnings += unmapped_gains(reader.names(path), column_map)
        return Recording(log, path, warnings=warnings)
    if period is not None and reader.on_grid is not None:
        return Recording(reader.on_grid(path, robot, period, suspended), path, is_on_grid=True)
    assert reader.read is not None
    return Recording(reader.read(path, robot), path, assumption=reader.assumption)


def _read_mapped(
    path: Path, reader: LogReader, columns: ColumnMap, robot: Robot | None
) -> MotorLog:
    if robot is not None and columns.robot not in ("", robot.name):
        raise ConfigError(
            f"robot {robot.name!r}, but the column map {columns.source} is for {columns.robot!r}",
            where=path,
            remedy=f"give {columns.robot!r} as robot, or correct robot in the map",
            argument="robot",
        )
    assert reader.columns is not None
    return read_mapped_log(path, columns, reader.columns, robot)


def reader_of(path: Path, with_columns: bool = False) -> LogReader:
    """The reader of a path, with or without a column map.

    Raises:
        LogError: no such file, or an unknown format; suggests a remedy.
    """
    if not path.exists():
        raise LogError("no such file", where=path, remedy="check the path")
    for reader in _usable_readers(with_columns):
        if reader.matches(path):
            return reader

    if path.is_dir():
        raise LogError("a folder that is not a log", where=path, remedy=_remedy_for_folder(path))
    for reader in READERS:
        if reader.columns is not None and reader.matches(path):
            remedy = f"read it {GIVE_COLUMNS}, or a shipped map: {', '.join(shipped_maps())}"
            raise LogError(reader.unmapped(path), where=path, remedy=remedy, argument="columns")
    formats = "; ".join(f"{reader.name} ({', '.join(reader.endings)})" for reader in READERS)
    raise LogError(
        "unknown log format", where=path, remedy=f"give one of: {formats}", argument="columns"
    )


def _usable_readers(with_columns: bool) -> list[LogReader]:
    if with_columns:
        return [reader for reader in READERS if reader.columns is not None]
    return [reader for reader in READERS if reader.read is not None]


def _remedy_for_folder(path: Path) -> str:
    endings = {_ending(file.name) for file in path.iterdir() if file.is_file()} - {""}
    if not endings:
        return "give a log (docs/logs.md)"
    return f"give its files: {' '.join(str(path / f'*{ending}') for ending in sorted(endings))}"


def recording_name(path: Path) -> str:
    """File name without the format's ending, run.1.csv.gz -> run.1."""
    name = path.absolute().name
    return name.removesuffix(_ending(name)) or name


def _ending(name: str) -> str:
    endings = {ending for reader in READERS for ending in reader.endings}
    return max((ending for ending in endings if name.endswith(ending)), key=len, default="")


@dataclass(frozen=True)
class LogFolder:
    """The logs of a folder."""

    logs: dict[str, MotorLog]  # by short name, sorted
    paths: tuple[Path, ...]  # files of the logs
    # "NAME: reason" for each file that looks like a log but cannot be read
    unreadable: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """All files of the logs, without the videos of LeRobot datasets."""
        files = []
        for path in self.paths:
            files += [path] if path.is_file() else sorted(path.rglob("*"))
        return [file for file in files if file.is_file() and file.suffix != ".mp4"]


def read_log_folder(path: Path, robot: Robot | None, columns: str | None = None) -> LogFolder:
    """Read a log, or every log of a folder.

    With a column map it reads all tables that fit the map. Without one it reads the motor logs
    (.parquet), else logs of jietan/puppersim except replays in simulation, else all files that a
    reader accepts. Arguments as `read_log`.

    Raises:
        LogError: no log, or none that can be read; the message has the reason for the first.
        ArtifactError: a bad column map.
    """
    column_map = None if columns is None else load_column_map(columns)
    readers_for_map = _usable_readers(column_map is not None)
    if not path.is_dir() or any(reader.matches(path) for reader in readers_for_map):
        return LogFolder({recording_name(path): read_log(path, robot, column_map)}, (path,))

    endings = tuple(ending for reader in readers_for_map for ending in reader.endings)
    entries = [entry for entry in sorted(path.iterdir()) if entry.name.endswith(endings)]
    names = {entry: recording_name(entry) for entry in entries}
    if column_map is None:
        names = _preferred(names, robot)

    logs = {}
    paths = []
    unreadable = []
    for entry, name in names.items():
        try:
            if name in logs:
                raise LogError(f"there is another log {name!r}")
            logs[name] = read_log(entry, robot, column_map)
            paths.append(entry)
        except MotorPriorError as error:
            unreadable.append(f"{entry.name}: {error.problem}")

    if not logs:
        maps = ", ".join(shipped_maps())
        raise LogError(
            "; ".join(["no log in it can be read", *unreadable[:1]]),
            where=path,
            remedy=f"give logs (docs/logs.md), or read tables {GIVE_COLUMNS} or a shipped map: "
            f"{maps}",
            argument="columns",
        )
    return LogFolder(logs, tuple(paths), tuple(unreadable))


def _preferred(names: dict[Path, str], robot: Robot | None) -> dict[Path, str]:
    """Motor logs of a folder, else logs of jietan/puppersim, else all."""
    motor_logs = {entry: name for entry, name in names.items() if entry.suffix == ".parquet"}
    if motor_logs:
        return motor_logs
    puppersim = {entry: short_name(entry) for entry in names if robot and short_name(entry)}
    return puppersim or names


def short_name(path: Path) -> str:
    """0116 of ``env_log_real_0116.csv.gz``.

    Empty unless it is a log of jietan/puppersim from the real robot.
    """
    file_name = re.fullmatch(r"env_(.+?)(\.csv\.gz|\.csv|\.txt)", path.name)
    words = file_name[1].split("_") if file_name else []
    if "real" not in words:
        return ""
    return "_".join(word for word in words if word not in ("log", "real"))
