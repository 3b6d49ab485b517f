"""Import recordings as motor logs: `load_log`, fitted loads if they are unknown, and a file per log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from motorprior.exceptions import ConfigError
from motorprior.logs.load_log import load_log
from motorprior.logs.prepare_log import PERIOD, LogSettings
from motorprior.logs.read_log import reader_of, recording_name
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.progress import SILENT, Progress
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import locked


@dataclass(frozen=True)
class LogsImport:
    """Convert recordings of a robot and raw logs to motor logs."""

    paths: tuple[Path, ...]
    """Logs in any format of docs/logs.md; with ``columns`` any table, ROS 2 bag or file of arrays."""
    out: Path
    """Folder for the .parquet files."""
    columns: str | None = None
    """Column map: a shipped one by name, or your .toml file (docs/your-motors.md)."""
    period: float | None = PERIOD
    """Sample period of the result [s]; None: the recorded rows."""
    kp: tuple[float, ...] = ()
    """Proportional gain during the log: one for all joints, or one per joint in the order of the robot, or of
    ``columns`` without one. Overrides the log and ``columns``, in the log's unit of gains: N·m/rad,
    or firmware units (Rhoban/bam, or if ``columns`` states so)."""
    kd: tuple[float, ...] = ()
    """Derivative gain, like ``kp``; in N·m·s/rad if that is in N·m/rad."""
    firmware: Mapping[str, float] = field(default_factory=dict)
    """Registers of all servos, as ``profile_speed 3 dead_zone 0.002``; they override the log and ``columns``; 0 is off.
    profile_acceleration [rad/s²], profile_speed [rad/s], dead_zone [rad]. Feetech STS: 0.1534
    rad/s² per unit."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """supply_voltage [V] and motor_temperature [°C] of all motors; they override the log and ``columns``."""
    suspended: bool = False
    """The robot was suspended with a level body: compute the loads of the motors from its model, as
    `identify` and `adapt` need. Logs that record another posture are rejected. A robot with a fixed
    base needs no such statement."""
    fit_load: bool = False
    """The motors are on a static base and each carries a rigid body of unknown inertia, the same in all logs: fit
    inertia and weight, and print them with standard deviations. Needs ``columns``, kp in N·m/rad
    and the default period; not with a robot, whose model gives the loads."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). The default is the shipped one
    for logs that do not name their joints; tables use the names of their map."""
    as_joint: tuple[str, ...] = ()
    """Names of the joints in the robot, in the log's order. Bench logs of a motor, such as Rhoban/bam's, become logs of
    ``robot``."""


def import_logs(config: LogsImport, progress: Progress = SILENT) -> None:
    """Write one .parquet per log, named after it, and report its content; errors as `load_log`."""
    if config.fit_load and (
        config.suspended or config.robot or not config.columns or config.period != PERIOD
    ):
        problem = "fit_load needs columns and the default period, and no robot"
        remedy = "give these, or suspended"
        raise ConfigError(problem, remedy=remedy, argument="fit_load")
    targets = _targets(config.paths, config.out)
    settings = LogSettings(
        period=None if config.fit_load else config.period,
        kp=config.kp,
        kd=config.kd,
        firmware=config.firmware,
        operating_conditions=config.conditions,
        as_joint=config.as_joint,
    )
    load = partial(
        load_log,
        columns=config.columns,
        suspended=config.suspended,
        settings=settings,
        progress=progress,
    )

    def robot_of(path: Path) -> str | None:
        lacks_robot = config.suspended or reader_of(path, config.columns is not None).needs_robot
        return config.robot or (DEFAULT_ROBOT if lacks_robot and not config.columns else None)

    with locked(config.out):
        logs = (load(path, robot=robot_of(path)) for path in targets.values())
        if config.fit_load:
            # here: importing it compiles
            from motorprior.identification.load_fit import with_fitted_loads

            logs = with_fitted_loads(list(logs), progress)
        for target, log in zip(targets, logs, strict=True):
            write_log(target, log)
            progress.note(f"{target}: {log if len(targets) == 1 else repr(log)}")


def _targets(paths: Sequence[Path], out: Path) -> dict[Path, Path]:
    """Output file (.parquet) -> log file; ConfigError if two logs have one, or it would overwrite a recording."""
    targets: dict[Path, Path] = {}
    for path in paths:
        target = out / f"{recording_name(path)}.parquet"
        if target in targets:
            raise ConfigError(
                f"it and {targets[target]} would both become {target}",
                where=path,
                remedy="rename one",
            )
        if path.exists() and target.exists() and target.samefile(path):
            problem = "out: the import would overwrite the recording"
            raise ConfigError(problem, where=target, remedy="give another folder", argument="out")
        targets[target] = path
    return targets
