"""Import raw logs as motor logs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motorprior.bounds import require_number
from motorprior.commands.fit_loads import write_with_fitted_loads
from motorprior.commands.import_files import report, targets_of
from motorprior.exceptions import ConfigError
from motorprior.logs.doctor.gap_segments import begin_at_gaps
from motorprior.logs.doctor.load import gravity_signs
from motorprior.logs.formats.column_map import KD, KP, load_column_map
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.formats.registry import read_log, unit_assumption
from motorprior.logs.formats.robot_run import ROBOT_RUN, Mode, read_robot_run
from motorprior.logs.given_settings import with_settings
from motorprior.logs.motor_log import CONDITIONS, FIRMWARE, MotorLog
from motorprior.logs.resampling import resample
from motorprior.progress import SILENT, WARNING, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import locked

_LOADS = ("load_inertia", "external_torque", "load_stiffness")


@dataclass(frozen=True)
class LogsImport:
    """Convert recordings of a robot and raw logs to motor logs."""

    paths: tuple[Path, ...]
    """Logs in any format of docs/logs.md: recordings of `motorprior record` or `deploy` (.csv), logs of
    jietan/puppersim (.csv, .csv.gz, .txt), Rhoban/bam (.json, .json.gz), folders of isaac-sim2real/sage and of LeRobot
    datasets, ROS 2 bags (.mcap, or its folder), or, with ``columns``, any table (.csv, .csv.gz, .parquet), any topics
    of a bag and tensors (.pt)."""
    out: Path
    """Folder for the .parquet files."""
    columns: str | None = None
    """Column map of a table, bag or .pt: a shipped map by name, or your .toml file (docs/your-motors.md)."""
    period: float | None = None
    """Sample period of the result [s]; as recorded if not given."""
    kp: tuple[float, ...] = ()
    """Proportional gain during the log: one for all joints, or one per joint in the order of the robot. Overrides the
    log and ``columns``, in the log's unit of gains: N·m/rad, or firmware units (Rhoban/bam, or if ``columns`` states
    so)."""
    kd: tuple[float, ...] = ()
    """Derivative gain, like ``kp``; in N·m·s/rad if that is in N·m/rad."""
    profile_acceleration: float | None = None
    """Acceleration limit of the servos' profile [rad/s²]; overrides ``columns``; 0 is off. Feetech STS: 0.1534 rad/s²
    per unit."""
    profile_speed: float | None = None
    """Speed limit of that profile [rad/s]; 0 is off."""
    dead_zone: float | None = None
    """Position error that the firmware ignores [rad]; 0 is off."""
    supply_voltage: float | None = None
    """Supply voltage of all motors [V]; overrides the log and ``columns``."""
    motor_temperature: float | None = None
    """Temperature of all motors [°C]; overrides the log and ``columns``."""
    suspended: bool = False
    """The robot was suspended with a level body, or has a fixed base: compute the loads of the motors from its model,
    as `identify` and `adapt` need. Logs that record another posture are rejected. The default period is the robot's
    physics step."""
    fit_load: bool = False
    """The motors are on a static base and each carries a rigid body of unknown inertia, the same in all logs: fit
    inertia and weight, print them with standard deviations, and save them in loads.json. Needs ``columns`` and kp in
    N·m/rad. The period is 2 ms. Not with a robot, whose model gives the loads."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). The default is the shipped one
    for logs that do not name their joints; tables use the names of their map."""


def require_paths(paths: tuple[Path, ...]) -> None:
    """Reject an empty list of logs.

    Raises:
        ConfigError: no log is given.
    """
    if not paths:
        raise ConfigError("no log given", remedy="give at least one file")


def import_logs(config: LogsImport, progress: Progress = SILENT) -> None:
    """Write one .parquet per log, named after it, and report its content.

    A segment begins after every gap. Gaps, assumptions of the format, and joint signs that contradict gravity are
    reported.

    Raises:
        ConfigError: two logs with one name, a log that would overwrite a recording, a period, gain or condition out of
            range, several gains without an order of the joints, or loads that are unknown or already in the log.
        LogError, ArtifactError: a log that cannot be read, or a folder that cannot be written or is in use.
    """
    require_paths(config.paths)
    if config.period is not None:
        require_number("period", config.period, 1e-6, 1.0)
    for name, values, bounds in (("kp", config.kp, KP), ("kd", config.kd, KD)):
        for value in values:
            require_number(name, value, *bounds)
    for name, value in _conditions(config).items():
        require_number(name, value, *CONDITIONS[name])
    if config.fit_load:
        config = _checked_for_fit(config)
    robot = load_robot(config.robot or DEFAULT_ROBOT)
    if config.suspended and config.columns is not None and config.robot is None:
        columns = load_column_map(config.columns)
        if columns.robot != DEFAULT_ROBOT:
            problem = "suspended: no model for the loads"
            remedy = "give robot, its .toml file (docs/your-robot.md); or fit_load without a model"
            raise ConfigError(problem, where=columns.source, remedy=remedy, argument="robot")
    targets = targets_of(config.paths, config.out)
    with locked(config.out):
        if config.fit_load:
            logs = {target: _imported(path, robot, config, progress) for target, path in targets.items()}
            write_with_fitted_loads(logs, config.out, progress)
            for target, log in logs.items():
                report(target, log, progress)
            return
        for target, path in targets.items():
            log = _imported(path, robot, config, progress)
            if config.suspended:
                _warn_of_signs(path, log, robot, progress)
            write_log(target, log)
            report(target, log, progress)


def _conditions(config: LogsImport) -> dict[str, float]:
    return {name: getattr(config, name) for name in CONDITIONS if getattr(config, name) is not None}


def _checked_for_fit(config: LogsImport) -> LogsImport:
    """The settings with the period of the fit.

    Raises:
        ConfigError: another period, another source of loads, or no column map.
    """
    from motorprior.identification.load_fit import RECIPE

    problem = ""
    if config.suspended:
        problem = "fit_load and suspended exclude each other"
    elif not config.columns:
        problem = "fit_load needs columns; in other formats the loads come from the robot's model, or from the log"
    elif config.robot is not None:
        problem = f"fit_load with a robot: the loads come from the model of {config.robot!r}"
    if problem:
        remedy = "remove fit_load; if the base was static, give suspended"
        raise ConfigError(problem, remedy=remedy, argument="fit_load")
    if config.period not in (None, RECIPE.period):
        problem = f"period {config.period:g} s: loads are fitted at {RECIPE.period:g} s"
        raise ConfigError(problem, remedy=f"give {RECIPE.period:g}", argument="period")
    return replace(config, period=RECIPE.period)


def _imported(path: Path, robot: Robot, config: LogsImport, progress: Progress) -> MotorLog:
    """One log with the given settings, at the given period, with loads if asked for.

    Raises:
        ConfigError: the log already has loads, its posture contradicts them, or several gains without an order.
        LogError: it cannot be read.
    """
    if config.columns is None and ROBOT_RUN.matches(path):
        return _with_given(_robot_run(path, robot, config), robot, config, progress)
    by_map = config.robot is None and config.columns is not None and not config.suspended
    log = _with_given(read_log(path, None if by_map else robot, config.columns), robot, config, progress)
    option = "suspended" if config.suspended else "fit_load" if config.fit_load else ""
    if option and (present := [name for name in _LOADS if getattr(log, name) is not None]):
        problem = f"{option}: the log already contains its load ({present[0]})"
        raise ConfigError(problem, where=path, remedy=f"remove {option}", argument=option)
    if config.suspended:
        from motorprior.simulation.suspended_load import require_fixed_base

        require_fixed_base(log, robot, path, "suspended")
    period = config.period or (robot.physics_dt if option else None)
    log, gaps = begin_at_gaps(log, period or 0.0)
    for message in filter(None, (gaps, unit_assumption(path, config.columns))):
        progress.note(f"{path}: {message}")
    if period is None:
        return log
    if config.suspended:
        return with_loads_on_grid(log, robot, period)
    if config.fit_load:
        from motorprior.identification.load_fit import require_physical_kp

        require_physical_kp(log)
        return smooth_on_grid(log, period)
    return resample(log, period)


def _warn_of_signs(path: Path, log: MotorLog, robot: Robot, progress: Progress) -> None:
    """Warn if gravity contradicts the signs of the joints."""
    from motorprior.simulation.suspended_load import gravity_torque

    gravity = gravity_torque(log, robot)
    for finding in [] if gravity is None else gravity_signs(log, gravity):
        progress.note(f"{WARNING}{path}: {finding.message} -> {finding.remedy}")


def with_loads_on_grid(log: MotorLog, robot: Robot, period: float) -> MotorLog:
    """The log of `smooth_on_grid` with the loads of a suspended or fixed robot."""
    from motorprior.simulation.suspended_load import with_loads

    return with_loads(smooth_on_grid(log, period), robot)


def _robot_run(path: Path, robot: Robot, config: LogsImport) -> MotorLog:
    if config.period is None and not config.suspended:
        return read_log(path, robot)
    period = config.period or robot.physics_dt
    if not config.suspended:
        return read_robot_run(path, robot, period=period)
    from motorprior.simulation.suspended_load import with_loads

    return with_loads(read_robot_run(path, robot, (Mode.EXCITE,), period), robot)


def _with_given(log: MotorLog, robot: Robot, config: LogsImport, progress: Progress) -> MotorLog:
    """The log with the settings that the user gives."""
    firmware = {name: getattr(config, name) for name in FIRMWARE if getattr(config, name) is not None}
    gains = {"kp": config.kp, "kd": config.kd}
    found, messages = with_settings(log, gains, firmware, _conditions(config), robot)
    for message in messages:
        progress.note(f"{log.source}: {message}")
    return found


def smooth_on_grid(log: MotorLog, period: float) -> MotorLog:
    """The log at steps of ``period`` [s]: commands held, angles splines through smoothed readings.

    Velocities are the splines' derivatives: recorded ones are often filtered, and loads need accelerations.
    """
    from scipy.interpolate import CubicSpline

    from motorprior.identification.training_data.smoothing import smoothed

    found = smoothed(log.joint_pos, tuple(log.segment_slices()), log.period)
    angles, grid = log.joint_pos if found is None else found[0], resample(log, period)
    pos, vel = np.empty_like(grid.joint_pos), np.empty_like(grid.joint_pos)
    for old, new in zip(log.segment_slices(), grid.segment_slices(), strict=True):
        spline = CubicSpline(log.time[old], angles[old], axis=0)
        pos[new], vel[new] = spline(grid.time[new]), spline(grid.time[new], 1)
    return replace(grid, joint_pos=pos, joint_vel=vel)
