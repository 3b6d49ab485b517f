"""Read every log of a folder, in any format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.logs.column_map import ColumnMap, load_column_map, shipped_maps
from motorprior.logs.log_reader import GIVE_COLUMNS
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.read_log import READERS, read_log, recording_name
from motorprior.logs.readers.puppersim import short_name
from motorprior.robots.robot import Robot


@dataclass(frozen=True)
class LogFolder:
    """The logs of a folder.

    Attributes:
        logs: by short name, sorted.
        paths: of the logs.
        unreadable: "NAME: reason" for each file that looks like a log but cannot be read.
    """

    logs: dict[str, MotorLog]
    paths: tuple[Path, ...]
    unreadable: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """All files of the logs, without the videos of LeRobot datasets."""
        found = [file for path in self.paths for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
        return [file for file in found if file.is_file() and file.suffix != ".mp4"]


def read_log_folder(path: Path, robot: Robot | None, columns: str | None = None) -> LogFolder:
    """Read a log, or every log of a folder.

    With a column map it reads all tables that fit the map. Without one it reads the motor logs (.parquet), else logs
    of jietan/puppersim except replays in simulation, else all files that a reader accepts.

    Args:
        path: file or folder.
        robot: the recorded robot; not needed for formats that name their joints.
        columns: name or file of a column map.

    Raises:
        LogError: no log, or none that can be read; the message has the reason for the first.
        ArtifactError: a bad column map.
    """
    column_map = None if columns is None else load_column_map(columns)
    readers = [reader for reader in READERS if (reader.columns if column_map else reader.read) is not None]
    if not path.is_dir() or any(reader.matches(path) for reader in readers):
        return LogFolder({recording_name(path): read_log(path, robot, column_map)}, (path,))
    entries = sorted(path.iterdir())
    if column_map is None and (found := [entry for entry in entries if entry.suffix == ".parquet"]):
        return LogFolder({recording_name(entry): read_log(entry, robot) for entry in found}, tuple(found))
    if column_map is None and robot is not None and (found := [entry for entry in entries if short_name(entry)]):
        return LogFolder({short_name(entry) or "": read_log(entry, robot) for entry in found}, tuple(found))
    endings = tuple(ending for reader in readers for ending in reader.endings)
    return _readable(path, [entry for entry in entries if entry.name.endswith(endings)], robot, column_map)


def _readable(folder: Path, paths: list[Path], robot: Robot | None, columns: ColumnMap | None) -> LogFolder:
    logs: dict[str, MotorLog] = {}
    taken: list[Path] = []
    unreadable: list[str] = []
    for path in paths:
        name = recording_name(path)
        try:
            if name in logs:
                raise LogError(f"there is another log {name!r}")
            logs[name] = read_log(path, robot, columns)
            taken.append(path)
        except (LogError, ConfigError, ArtifactError) as error:
            unreadable.append(f"{path.name}: {error.problem}")
    if not logs:
        reason = f"; {unreadable[0]}" if unreadable else ""
        remedy = (
            f"give logs (docs/logs.md), or read tables {GIVE_COLUMNS} or a shipped map: {', '.join(shipped_maps())}"
        )
        raise LogError(f"no log in it can be read{reason}", where=folder, remedy=remedy, argument="columns")
    return LogFolder(logs, tuple(taken), tuple(unreadable))
