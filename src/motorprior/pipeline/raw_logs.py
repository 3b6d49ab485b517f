"""Raw logs of a robot, brought in as motor logs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.parquet_io import write_log
from motorprior.logs.registry import read_log
from motorprior.logs.robot_run import Mode, is_robot_run, read_robot_run
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class LogsImport:
    """Convert recordings of a robot and raw logs to motor logs."""

    paths: tuple[Path, ...]
    """Recordings of `motorprior record` or `deploy` (.csv), or raw logs (.csv, .csv.gz, original .txt pickles)."""
    out: Path
    """Folder for the .parquet files."""
    period: float | None = None
    """Sample period of the result [s], for recordings of a robot; as recorded if not given."""
    hung: bool = False
    """A recording of `motorprior record` for which the robot hung in the air with its body level: add the load of every
    motor, which `adapt` needs. At the robot's physics step unless another period is given."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def require_paths(paths: tuple[Path, ...]) -> None:
    """Refuse to do nothing.

    Raises:
        ConfigError: no log is given.
    """
    if not paths:
        raise ConfigError("no log given", remedy="give at least one file")


def import_logs(config: LogsImport) -> None:
    """Write one .parquet per raw log, named after it.

    Raises:
        ConfigError: two logs would get the same name, or a period that is not positive.
        LogError, ArtifactError: a log that cannot be read, a folder that cannot be written.
    """
    require_paths(config.paths)
    if config.period is not None and not 0.0 < config.period < 1.0:
        raise ConfigError(
            f"period {config.period:g} s is out of range", remedy="give for example 0.002", argument="period"
        )
    robot = load_robot(config.robot)
    targets: dict[Path, Path] = {}
    for path in config.paths:
        target = config.out / (path.name.split(".")[0] + ".parquet")
        if target in targets:
            raise ConfigError(f"it and {targets[target]} would both become {target}", where=path, remedy="rename one")
        targets[target] = path
    for target, path in targets.items():
        write_log(target, _imported(path, robot, config))


def _imported(path: Path, robot: Robot, config: LogsImport) -> MotorLog:
    """One log as it was asked for.

    Raises:
        ConfigError: a period or a load for something else than a recording of a robot.
        LogError: it cannot be read.
    """
    if config.period is None and not config.hung:
        return read_log(path, robot)
    if not is_robot_run(path):
        raise ConfigError(
            "a period or a load is for recordings of `motorprior record` and `deploy`", where=path,
            remedy="leave them out",
        )  # fmt: skip
    period = config.period or robot.physics_dt
    if not config.hung:
        return read_robot_run(path, robot, period=period)
    from motorprior.simulation.hung_load import with_loads

    return with_loads(read_robot_run(path, robot, (Mode.EXCITE,), period), robot)
