"""Read every log of a folder, in any format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.logs.formats.column_map import ColumnMap, load_column_map, shipped_maps
from motorprior.logs.formats.lerobot import is_lerobot_folder, lerobot_files
from motorprior.logs.formats.puppersim import read_puppersim_logs, short_name
from motorprior.logs.formats.registry import READERS, TABLES, read_log, recording_name
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


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
        return [file for path in self.paths for file in _files(path)]


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
    if path.is_file() or (path.is_dir() and any(reader.matches(path) for reader in READERS)):
        return LogFolder({recording_name(path): read_log(path, robot, column_map)}, (path,))
    entries = sorted(path.iterdir()) if path.is_dir() else []
    if column_map is not None and entries:
        return _readable(path, [entry for entry in entries if entry.name.endswith(TABLES)], robot, column_map)
    if found := [entry for entry in entries if entry.suffix == ".parquet"]:
        return LogFolder({recording_name(entry): read_log(entry, robot) for entry in found}, tuple(found))
    if robot is not None and (found := [entry for entry in entries if short_name(entry)]):
        return LogFolder(read_puppersim_logs(path, robot), tuple(found))
    if found := [entry for entry in entries if any(reader.matches(entry) for reader in READERS)]:
        return _readable(path, found, robot, None)
    if tensors := [entry for entry in entries if entry.suffix == ".pt"]:
        read_log(tensors[0], robot)  # its error lists the tensors and the shipped maps
    if robot is not None and robot.name == DEFAULT_ROBOT:
        read_puppersim_logs(path, robot)  # its error states where to find logs
    raise LogError("no log in it", where=path, remedy="give a log, or a folder of logs (docs/logs.md)")


def _files(path: Path) -> list[Path]:
    if is_lerobot_folder(path):
        return lerobot_files(path)
    return sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]


def _readable(folder: Path, paths: list[Path], robot: Robot | None, columns: ColumnMap | None) -> LogFolder:
    logs: dict[str, MotorLog] = {}
    taken: list[Path] = []
    unreadable: list[str] = []
    needs_columns = not paths
    for path in paths:
        name = recording_name(path)
        try:
            if name in logs:
                raise LogError(f"there is another log {name!r}")
            logs[name] = read_log(path, robot, columns)
            taken.append(path)
        except (LogError, ConfigError, ArtifactError) as error:
            unreadable.append(f"{path.name}: {error.problem}")
            needs_columns |= error.argument == "columns"
    if logs:
        return LogFolder(logs, tuple(taken), tuple(unreadable))
    remedy = "run `motorprior logs check` on each file"
    if needs_columns:
        remedy = (
            f"give columns, a column map: one of {', '.join(shipped_maps())}, or your .toml file; or give the robot"
        )
    reason = f"; {unreadable[0]}" if unreadable else ""
    argument = "columns" if needs_columns else None
    raise LogError(f"no log in it can be read{reason}", where=folder, remedy=remedy, argument=argument)
