"""Read a log in any format or every log of a folder, and prepare it: settings, gaps, grid, loads.

A new format is a file in `logs.readers` with its `LogReader` as READER.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError, LogError, MotorPriorError, listed
from motorprior.logs import readers
from motorprior.logs.column_map import ColumnMap, load_column_map, shipped_maps
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import grouped
from motorprior.logs.doctor.readings import failed_reads
from motorprior.logs.doctor.signs import gravity_signs
from motorprior.logs.loads import LOADS, require_fixed_base, with_loads
from motorprior.logs.log_reader import GIVE_COLUMNS, LogReader, read_mapped_log
from motorprior.logs.motor_log import OPERATING_CONDITIONS, MotorLog, checked
from motorprior.logs.operations import begin_at_gaps, resample, smooth_on_grid
from motorprior.progress import WARNED, WARNING, Progress
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot

PERIOD = 0.002  # sample period of the identification presets for real motors [s]
READERS: tuple[LogReader, ...] = tuple(
    import_module(f"{readers.__name__}.{module.name}").READER for module in iter_modules(readers.__path__)
)


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
    column_map = load_column_map(columns)
    if robot is not None and column_map.robot not in ("", robot.name):
        problem = f"robot {robot.name!r}, but the column map {column_map.source} is for {column_map.robot!r}"
        remedy = f"give {column_map.robot!r} as robot, or correct robot in the map"
        raise ConfigError(problem, where=path, remedy=remedy, argument="robot")
    assert reader.columns is not None
    return read_mapped_log(path, column_map, reader.columns, robot)


def reader_of(path: Path, with_columns: bool = False) -> LogReader:
    """The reader of a path, with or without a column map; else LogError, which suggests a remedy."""
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


@dataclass(frozen=True)
class LogFolder:
    """The logs of a folder."""

    logs: dict[str, MotorLog]  # by short name, sorted
    paths: tuple[Path, ...]  # files of the logs
    unreadable: tuple[str, ...] = ()  # "NAME: reason" for each file that looks like a log but cannot be read

    @property
    def files(self) -> list[Path]:
        """All files of the logs, without the videos of LeRobot datasets."""
        found = [file for path in self.paths for file in ([path] if path.is_file() else sorted(path.rglob("*")))]
        return [file for file in found if file.is_file() and file.suffix != ".mp4"]


def read_log_folder(path: Path, robot: Robot | None, columns: str | None = None) -> LogFolder:
    """Read a log, or every log of a folder.

    With a column map it reads all tables that fit the map. Without one it reads the motor logs (.parquet), else logs
    of jietan/puppersim except replays in simulation, else all files that a reader accepts. Arguments as `read_log`.

    Raises:
        LogError: no log, or none that can be read; the message has the reason for the first.
        ArtifactError: a bad column map.
    """
    column_map = None if columns is None else load_column_map(columns)
    known = [reader for reader in READERS if (reader.columns if column_map else reader.read) is not None]
    if not path.is_dir() or any(reader.matches(path) for reader in known):
        return LogFolder({recording_name(path): read_log(path, robot, column_map)}, (path,))
    endings = tuple(ending for reader in known for ending in reader.endings)
    entries = {entry: recording_name(entry) for entry in sorted(path.iterdir()) if entry.name.endswith(endings)}
    if column_map is None:
        written = {entry: name for entry, name in entries.items() if entry.suffix == ".parquet"}
        entries = written or {entry: name for entry in entries if robot and (name := short_name(entry))} or entries
    logs, taken, unreadable = {}, [], []
    for entry, name in entries.items():
        try:
            if name in logs:
                raise LogError(f"there is another log {name!r}")
            logs[name] = read_log(entry, robot, column_map)
            taken.append(entry)
        except MotorPriorError as error:
            unreadable.append(f"{entry.name}: {error.problem}")
    if not logs:
        problem = "; ".join(["no log in it can be read", *unreadable[:1]])
        remedy = f"give logs (docs/logs.md), or read tables {GIVE_COLUMNS} or a shipped map: "
        raise LogError(problem, where=path, remedy=remedy + ", ".join(shipped_maps()), argument="columns")
    return LogFolder(logs, tuple(taken), tuple(unreadable))


def short_name(path: Path) -> str:
    """0116 of ``env_log_real_0116.csv.gz``; empty unless it is a log of jietan/puppersim from the real robot."""
    found = re.fullmatch(r"env_(.+?)(\.csv\.gz|\.csv|\.txt)", path.name)
    words = found[1].split("_") if found else []
    return "_".join(word for word in words if word not in ("log", "real")) if "real" in words else ""


def load_log(
    path: str | Path,
    *,
    columns: ColumnMap | str | Path | None = None,
    robot: Robot | str | Path | None = None,
    suspended: bool = False,
    period: float | None = PERIOD,
    kp: float | Sequence[float] = (),
    kd: float | Sequence[float] = (),
    firmware: Mapping[str, float] | None = None,
    conditions: Mapping[str, float] | None = None,
    as_joint: Sequence[str] = (),
    progress: Progress = WARNED,
) -> MotorLog:
    """Read a recording in any format and prepare it for `fit_prior` and `adapt`.

    Rows in which a read failed are left out. A segment begins after every gap. Both, errors that `check_log` finds,
    assumptions of the format, and joint signs that contradict gravity are reported.

    Args:
        path: as in `read_log`.
        columns: as in `read_log`.
        robot: the recorded robot, its name or its .toml file; gives the loads, and the joints of formats that do not
            name them.
        suspended: the robot was suspended with a level body, or has a fixed base: smooth the readings and compute the
            loads of the motors from the model of ``robot``. Otherwise loads are those of the log, if it has any.
        period: time step of the result [s]; None keeps the recorded rows.
        kp: proportional gain during the log, in its unit of gains: one for all joints, or one per joint in the order of
            the robot, or of ``columns`` without one. Overrides the log and ``columns``.
        kd: derivative gain, likewise.
        firmware: registers of `motor_log.FIRMWARE`, in SI units; they override those of the log.
        conditions: some of `motor_log.OPERATING_CONDITIONS`, for all joints and rows; they override those of the log.
        as_joint: names of the joints of ``robot`` for those of the log, in its order: the log, for example of a bench,
            is then one of motors of this robot.
        progress: where to report to; by default warnings are Python warnings.

    Raises:
        ConfigError: a period out of range, another number of gains, or loads without a robot or period, or for a log
            that has loads; joints that are none of the robot's, without ``as_joint``.
        LogError: the log cannot be read, lacks what loads need, or a given value is out of its bounds.
        ArtifactError: a bad column map or robot.
    """
    robot, path = None if robot is None else as_robot(robot), Path(path)
    reader, model = reader_of(path, columns is not None), robot if suspended else None
    if period is not None:
        require_number("period", period, 1e-6, 1.0)
    if suspended and (robot is None or period is None):
        problem, remedy = "suspended: no model for the loads", "give robot, its .toml file (docs/your-robot.md)"
        raise ConfigError(problem, where=path, remedy=f"{remedy}, and a period", argument="robot")
    on_grid = None if period is None or columns else reader.on_grid
    log = on_grid(path, robot, period or 0.0, suspended) if on_grid else read_log(path, robot, columns)
    log = _of_robot(log, robot, tuple(as_joint), path)
    log = _with_settings(log, kp, kd, firmware, conditions, progress)
    if robot is not None and set(log.joint_names) <= set(robot.joint_names):
        classes = dict(zip(robot.joint_names, robot.joint_classes, strict=True))
        log = replace(log, given_classes=tuple(classes[name] for name in log.joint_names))
    if on_grid is None:
        if model is not None:
            if present := [name for name in LOADS if getattr(log, name) is not None]:
                problem = f"suspended: the log already contains its load ({present[0]})"
                raise ConfigError(problem, where=path, remedy="remove suspended", argument="suspended")
            require_fixed_base(log, model, path)
        log, lines = cleaned(log, str(path), period or 0.0)
        for line in [*lines, *([f"{path}: {reader.assumption}"] if reader.assumption and not columns else [])]:
            progress.note(line)
        if period is not None:
            log = resample(log, period) if model is None else smooth_on_grid(log, period)
    if model is not None:
        log = with_loads(log, model)
        for finding in gravity_signs(log, model):
            progress.note(f"{WARNING}{path}: {finding.message} -> {finding.remedy}")
    return log


def _of_robot(log: MotorLog, robot: Robot | None, as_joint: tuple[str, ...], path: Path) -> MotorLog:
    """The log with joints of the robot, if their names are given."""
    if as_joint and robot is None:
        raise ConfigError("as_joint without a robot", remedy="give robot", argument="as_joint")
    known = robot is not None and (log.robot == robot.name or set(log.joint_names) & set(robot.joint_names))
    if robot is None or (known and not as_joint):
        return log
    if len(as_joint) == log.num_joints and len(set(as_joint) & set(robot.joint_names)) == len(as_joint):
        return checked(replace(log, joint_names=as_joint, robot=robot.name))
    problem = f"its joints {listed(log.joint_names, 8)} are none of {robot.name}'s"
    if as_joint:
        problem = f"as_joint {', '.join(as_joint)} does not name {log.num_joints} different joints of {robot.name}"
    remedy = f"state which they are by as_joint, such as {robot.joint_names[0]}, of {', '.join(robot.joint_names)}"
    raise ConfigError(problem, where=path, remedy=remedy, argument="as_joint")


def cleaned(log: MotorLog, name: str, period: float = 0.0) -> tuple[MotorLog, list[str]]:
    """The log without rows in which a read failed, with a segment after every gap; and lines about both.

    Lines begin with the ``name`` of the log. Further lines are warnings of the errors that `check_log` finds.

    Raises:
        LogError: as `begin_at_gaps`; a rate that no motor is recorded at; or a segment that has fewer than 2 rows
            without failed reads.
    """
    failed = failed_reads(log)
    counts, rows = failed.sum(axis=0), np.asarray(failed.any(axis=1))
    named = [f"{name} {count}" for name, count in zip(log.joint_names, counts, strict=True) if count]
    warnings = [f"{rows.sum()} rows in which a read failed are left out ({listed(named, 8)})"] if named else []
    log, gaps = begin_at_gaps(checked(log.rows(~rows)) if named else log, period)
    for error in grouped(check_log(log).errors):
        if error.check == "rate":
            raise LogError(error.message, where=log.source, remedy=error.remedy)
        warnings.append(f"{error.message} -> {error.remedy}")
    return log, [*(f"{WARNING}{name}: {text}" for text in warnings), *([f"{name}: {gaps}"] if gaps else [])]


def _with_settings(
    log: MotorLog,
    kp: float | Sequence[float],
    kd: float | Sequence[float],
    firmware: Mapping[str, float] | None,
    conditions: Mapping[str, float] | None,
    progress: Progress,
) -> MotorLog:
    values: dict[str, Any] = {"firmware": {**log.firmware, **(firmware or {})}}
    for name, given in (("kp", np.ravel(kp)), ("kd", np.ravel(kd))):
        if given.size not in (0, 1, log.num_joints):
            problem = f"{name}: {given.size} gains for {log.num_joints} joints"
            raise ConfigError(problem, remedy="give one, or one per joint", argument=name)
        if given.size > 1:
            pairs = zip(log.joint_names, given.tolist(), strict=True)
            progress.note(f"{log.source}: {name}: {', '.join(f'{joint} {value:g}' for joint, value in pairs)}")
        if given.size:
            values[f"logged_{name}"] = np.broadcast_to(given, log.joint_pos.shape)
    for name, value in (conditions or {}).items():
        if name not in OPERATING_CONDITIONS:
            remedy = f"give {' or '.join(OPERATING_CONDITIONS)}"
            raise ConfigError(f"condition {name!r}", remedy=remedy, argument="conditions")
        values[name] = np.full(log.joint_pos.shape, value)
    return checked(replace(log, **values))
