"""Every log of a folder, whatever its format."""

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
    """What a folder holds.

    Attributes:
        logs: by short name, sorted.
        paths: that they were read from.
        left_out: of every file that looked like a log and is none, its name and why; a line each.
    """

    logs: dict[str, MotorLog]
    paths: tuple[Path, ...]
    left_out: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """The paths, of those that are folders all that is in them; of a LeRobot dataset what is read of it."""
        return [file for path in self.paths for file in _files(path)]


def read_log_folder(path: Path, robot: Robot | None, columns: str | None = None) -> LogFolder:
    """A log, or every log of a folder.

    Of a folder without a column map: its motor logs (.parquet) if it has any, or else its raw logs of jietan/puppersim,
    replays in simulation left out, or else all that a reader takes; the last may fail for some files, not for all. With
    a map: all tables that it fits.

    Args:
        path: file or folder.
        robot: that was recorded; formats that name their joints need none.
        columns: name or file of a column map.

    Raises:
        LogError: nothing there, or no log that can be read; says what was wrong with the first.
        ArtifactError: a column map that cannot be used.
    """
    known = None if columns is None else load_column_map(columns)
    if path.is_file() or (path.is_dir() and any(reader.takes(path) for reader in READERS)):
        return LogFolder({recording_name(path): read_log(path, robot, known)}, (path,))
    entries = sorted(path.iterdir()) if path.is_dir() else []
    if known is not None and entries:
        return _readable(path, [entry for entry in entries if entry.name.endswith(TABLES)], robot, known)
    if found := [entry for entry in entries if entry.suffix == ".parquet"]:
        return LogFolder({recording_name(entry): read_log(entry, robot) for entry in found}, tuple(found))
    if robot is not None and (found := [entry for entry in entries if short_name(entry)]):
        return LogFolder(read_puppersim_logs(path, robot), tuple(found))
    if found := [entry for entry in entries if any(reader.takes(entry) for reader in READERS)]:
        return _readable(path, found, robot, None)
    if tensors := [entry for entry in entries if entry.suffix == ".pt"]:
        read_log(tensors[0], robot)  # which says what they are and which maps there are
    if robot is not None and robot.name == DEFAULT_ROBOT:
        read_puppersim_logs(path, robot)  # which says where logs are found
    raise LogError("no log in it", where=path, remedy="give a log, or a folder of logs (docs/logs.md)")


def _files(path: Path) -> list[Path]:
    if is_lerobot_folder(path):
        return lerobot_files(path)
    return sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]


def _readable(folder: Path, paths: list[Path], robot: Robot | None, columns: ColumnMap | None) -> LogFolder:
    logs: dict[str, MotorLog] = {}
    taken: list[Path] = []
    left_out: list[str] = []
    asks_for_columns = False
    for path in paths:
        try:
            log = read_log(path, robot, columns)
        except (LogError, ConfigError, ArtifactError) as error:
            left_out.append(f"{path.name}: {error.problem}")
            asks_for_columns |= error.argument == "columns"
            continue
        name = recording_name(path)
        if name in logs:
            left_out.append(f"{path.name}: there is another log {name!r}")
            continue
        logs[name] = log
        taken.append(path)
    if logs:
        return LogFolder(logs, tuple(taken), tuple(left_out))
    first = f"; {left_out[0]}" if left_out else ""
    raise LogError(
        f"no log in it can be read{first}", where=folder, remedy=_remedy(asks_for_columns or not left_out),
        argument="columns" if asks_for_columns else None,
    )  # fmt: skip


def _remedy(asks_for_columns: bool) -> str:
    if not asks_for_columns:
        return "mend or leave out what is wrong with them: `motorprior logs check` says more of each"
    maps = ", ".join(shipped_maps())
    return f"give columns, what the names in its tables mean: one of {maps}, or your .toml file; or give the robot"
