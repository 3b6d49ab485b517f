"""Import recordings as motor logs: `load_log`, fitted loads if unknown, and a file per log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from motorprior.exceptions import ConfigError
from motorprior.logs.load_log import load_log
from motorprior.logs.motor_log import MotorLog
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
    """Logs in any format of docs/logs.md; with `--columns` also any table, ROS 2 bag or file of
    arrays."""
    out: Path
    """Folder for the .parquet files."""
    columns: str | None = None
    """Column map: name of a shipped map, or your .toml file (docs/your-motors.md)."""
    period: float | None = PERIOD
    """Sample period of the motor logs [s]; None keeps the recorded rows."""
    kp: tuple[float, ...] = ()
    """Position gain of the motors during the log: one value for all joints, or one per joint in the
    order of the robot's joints (without a robot, in the order of `--columns`). The unit is N·m/rad,
    or the firmware's unit for logs of Rhoban/bam and where `--columns` states so. The setting
    overrides the log and `--columns`."""
    kd: tuple[float, ...] = ()
    """Velocity gain of the motors during the log, given like `--kp`; the unit is N·m·s/rad if that
    of kp is N·m/rad."""
    firmware: Mapping[str, float] = field(default_factory=dict)
    """Registers of all servos, such as `profile_speed 3 dead_zone 0.002`: profile_acceleration
    [rad/s²] (Feetech STS: 0.1534 rad/s² per unit), profile_speed [rad/s] and dead_zone [rad]; 0
    switches a register off. The setting overrides the log and `--columns`."""
    operating_conditions: Mapping[str, float] = field(default_factory=dict)
    """Operating conditions of all motors: supply_voltage [V] and motor_temperature [°C]. The
    setting overrides the log and `--columns`."""
    suspended: bool = False
    """The robot was suspended in the air, level unless the log has its orientation, so that its
    model gives the loads of the motors, which `identify` and `adapt` need. Logs that record another
    posture are rejected. A robot with a fixed base does not need this setting."""
    fit_load: bool = False
    """Fit the unknown load of each motor, and print its inertia and weight with standard
    deviations. The motors must be on a static base, each with a rigid body that is the same in all
    logs. Needs `--columns`, kp in N·m/rad and the default period; not for a robot, whose model
    gives the loads."""
    robot: str | None = None
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md). If not
    given, logs without names of joints are logs of the shipped robot, and tables have the names in
    their column map."""
    as_joint: tuple[str, ...] = ()
    """Names of the robot's joints for the motors in the log, in the log's order. Bench logs of a
    motor, such as those of Rhoban/bam, become logs of `--robot`."""


def import_logs(config: LogsImport, progress: Progress = SILENT) -> None:
    """Write one .parquet per log, named after it, and report its content; errors as `load_log`."""
    if config.fit_load:
        _require_bench(config)
    targets = _targets(config.paths, config.out)

    with locked(config.out):
        logs = (_loaded(path, config, progress) for path in targets.values())
        if config.fit_load:
            # here: importing it compiles
            from motorprior.identification.load_fit import with_fitted_loads

            logs = with_fitted_loads(list(logs), progress)
        for target, log in zip(targets, logs, strict=True):
            write_log(target, log)
            progress.note(f"{target}: {log if len(targets) == 1 else repr(log)}")


def _require_bench(config: LogsImport) -> None:
    """Raise ConfigError unless loads can be fitted with these settings."""
    has_model = config.suspended or config.robot
    if has_model or not config.columns or config.period != PERIOD:
        raise ConfigError(
            "fit_load needs columns and the default period, and no robot",
            remedy="give these, or suspended",
            argument="fit_load",
        )


def _loaded(path: Path, config: LogsImport, progress: Progress) -> MotorLog:
    settings = LogSettings(
        period=None if config.fit_load else config.period,
        kp=config.kp,
        kd=config.kd,
        firmware=config.firmware,
        operating_conditions=config.operating_conditions,
        as_joint=config.as_joint,
    )
    return load_log(
        path,
        columns=config.columns,
        robot=_robot_of(path, config),
        suspended=config.suspended,
        settings=settings,
        progress=progress,
        allow_errors=True,  # they are printed as warnings
    )


def _robot_of(path: Path, config: LogsImport) -> str | None:
    """The given robot, or the shipped one for logs that need a robot; tables name their joints."""
    if config.robot or config.columns:
        return config.robot
    if config.suspended or reader_of(path).needs_robot:
        return DEFAULT_ROBOT
    return None


def _targets(paths: Sequence[Path], out: Path) -> dict[Path, Path]:
    """Output file (.parquet) -> log file.

    Raises:
        ConfigError: two logs have one output file, or it would overwrite a recording.
    """
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
            raise ConfigError(
                "out: the import would overwrite the recording",
                where=target,
                remedy="give another folder",
                argument="out",
            )
        targets[target] = path
    return targets
