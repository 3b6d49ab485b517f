"""Raw logs of a robot, brought in as motor logs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.logs.doctor.gap_segments import begin_at_gaps
from motorprior.logs.doctor.gravity_checks import signs
from motorprior.logs.formats.column_map import load_column_map
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.formats.registry import read_log, taken_for_granted
from motorprior.logs.formats.robot_run import ROBOT_RUN, Mode, read_robot_run
from motorprior.logs.motor_log import CONDITIONS, FIRMWARE, MotorLog
from motorprior.logs.resampling import resample
from motorprior.pipeline.log_import.import_files import targets_of, tell, tell_replaced
from motorprior.pipeline.log_import.stated_settings import require_within_bounds, with_stated
from motorprior.pipeline.log_import.unknown_load import write_with_unknown_loads
from motorprior.pipeline.progress import SILENT, WARNING, Progress
from motorprior.pipeline.stage import locked
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT

SHORTEST_PERIOD, LONGEST_PERIOD = 1e-6, 1.0
"""Of a grid [s]; a recipe's sample period has the same bounds."""


@dataclass(frozen=True)
class LogsImport:
    """Convert recordings of a robot and raw logs to motor logs."""

    paths: tuple[Path, ...]
    """Logs in any format of docs/logs.md: recordings of `motorprior record` or `deploy` (.csv), raw logs of
    jietan/puppersim (.csv, .csv.gz, .txt), Rhoban/bam (.json, .json.gz), folders of isaac-sim2real/sage and of LeRobot
    datasets, ROS 2 bags (.mcap, or the folder of one), or, with ``columns``, any table (.csv, .csv.gz, .parquet), any
    topics of a bag and tensors (.pt)."""
    out: Path
    """Folder for the .parquet files."""
    columns: str | None = None
    """What columns of a table, or tensors, mean: a shipped map by name, or your .toml file (docs/your-motors.md)."""
    period: float | None = None
    """Sample period of the result [s]; as recorded if not given."""
    kp: tuple[float, ...] = ()
    """Proportional gain that the motors were told: one for all joints, or one per joint in the order of the robot that
    is given. Takes the place of the log's or of what ``columns`` says, in the unit of the log's own gains: N·m/rad, or
    that of the firmware, as of logs of Rhoban/bam and where ``columns`` says so."""
    kd: tuple[float, ...] = ()
    """Derivative gain, like ``kp``; N·m·s/rad where that is in N·m/rad."""
    profile_acceleration: float | None = None
    """Largest acceleration of the profile that every servo's firmware was told [rad/s²], in place of what ``columns``
    says; 0 if it has no such limit. Feetech STS: 0.1534 rad/s² per unit."""
    profile_speed: float | None = None
    """Largest speed of that profile [rad/s]; 0 if it has no such limit."""
    dead_zone: float | None = None
    """Error that the firmware does not act on [rad]; 0 if there is none."""
    supply_voltage: float | None = None
    """At all motors [V], in place of what the log or ``columns`` says."""
    motor_temperature: float | None = None
    """Of all motors [°C], likewise."""
    suspended: bool = False
    """The robot was suspended with its body level, or has a fixed base: add the load of every motor, which
    `identify` and `adapt` need. At the robot's physics step unless another period is given. A log that states another
    posture in any of its rows is refused."""
    fit_load: bool = False
    """Tables of motors on a base that stands still, each with a rigid body on its joint that nobody weighed, the same
    in all tables: fit the body's inertia and weight, which needs kp in N·m/rad. They are printed with standard
    deviations and kept in loads.json. The period is 2 ms. Needs ``columns``, and no robot: a model says the loads."""
    robot: str | None = None
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). If none is given, logs that do
    not name their joints are of the shipped one, and a table's joints are called as its map calls them."""


def require_paths(paths: tuple[Path, ...]) -> None:
    """Refuse to do nothing.

    Raises:
        ConfigError: no log is given.
    """
    if not paths:
        raise ConfigError("no log given", remedy="give at least one file")


def import_logs(config: LogsImport, progress: Progress = SILENT) -> None:
    """Write one .parquet per raw log, named after it, and say what is in it.

    A segment begins after every gap, which is told, as is what a format takes for granted. A warning, where loads are
    added and gravity says that the model's joints have other signs.

    Raises:
        ConfigError: two logs would get the same name, a log would take the place of a recording, a period or a gain
            that is out of range, a period too short for a log, gains of which it is not known to which joint they
            belong, loads to be fitted that are known, or could be, or loads of a held base for a log that states
            another posture.
        LogError, ArtifactError: a log that cannot be read, a folder that cannot be written, or that another command
            writes to: of two logs of one name only one would be left.
    """
    require_paths(config.paths)
    if config.period is not None:
        require_number("period", config.period, SHORTEST_PERIOD, LONGEST_PERIOD)
    require_within_bounds(_gains(config) | {name: (value,) for name, value in _conditions(config).items()})
    if config.fit_load:
        config = _to_fit(config)
    robot = load_robot(config.robot or DEFAULT_ROBOT)
    _require_robot_of_held_base(config)
    targets = targets_of(config.paths, config.out)
    with locked(config.out):
        if config.fit_load:
            logs = {target: _imported(path, robot, config, progress) for target, path in targets.items()}
            write_with_unknown_loads(logs, config.out, progress)
            for target, log in logs.items():
                tell(target, log, progress)
            return
        for target, path in targets.items():
            log = _imported(path, robot, config, progress)
            tell_replaced(target, log, progress)
            if config.suspended:
                _note_signs(path, log, robot, progress)
            write_log(target, log)
            tell(target, log, progress)


def _require_robot_of_held_base(config: LogsImport) -> None:
    """Refuse a table of joints of nobody's, whose loads no model tells.

    Raises:
        ConfigError: suspended, without a robot, and the column map is not of the default robot.
    """
    if config.suspended and config.columns is not None and config.robot is None:
        columns = load_column_map(config.columns)
        if columns.robot != DEFAULT_ROBOT:
            problem = "suspended: the loads of these joints come from the model of their robot, and none was given"
            remedy = "give robot, its .toml file (docs/your-robot.md); or fit_load, where no model is known"
            raise ConfigError(problem, where=columns.source, remedy=remedy, argument="robot")


def _gains(config: LogsImport) -> dict[str, tuple[float, ...]]:
    return {"kp": config.kp, "kd": config.kd}


def _conditions(config: LogsImport) -> dict[str, float]:
    return {name: getattr(config, name) for name in CONDITIONS if getattr(config, name) is not None}


def _to_fit(config: LogsImport) -> LogsImport:
    """The settings at the period of the fit.

    Raises:
        ConfigError: another period, another way to have loads, or no column map.
    """
    from motorprior.identification.load_fit import RECIPE

    odd = {
        "suspended and fit_load are two ways to have loads": config.suspended,
        "fit_load needs columns: of other formats the robot's model, or the log, says the loads": not config.columns,
        f"fit_load with a robot: the model of {config.robot!r} says the loads": config.robot is not None,
    }
    for problem in (problem for problem, found in odd.items() if found):
        remedy = "leave fit_load out and, where the base does not move, give suspended"
        raise ConfigError(problem, remedy=remedy, argument="fit_load")
    if config.period not in (None, RECIPE.period):
        raise ConfigError(
            f"period {config.period:g} s: loads are fitted at {RECIPE.period:g} s", remedy=f"give {RECIPE.period:g}",
            argument="period",
        )  # fmt: skip
    return replace(config, period=RECIPE.period)


def _imported(path: Path, robot: Robot, config: LogsImport, progress: Progress) -> MotorLog:
    """One log as it was asked for.

    Raises:
        ConfigError: loads are asked for that the log has, or that its posture rules out, or gains for nobody knows
            which joint.
        LogError: it cannot be read.
    """
    if config.columns is None and ROBOT_RUN.takes(path):
        return _with_what_is_stated(_robot_run(path, robot, config), robot, config, progress)
    unnamed = config.robot is None and config.columns is not None and not config.suspended
    log = _with_what_is_stated(read_log(path, None if unnamed else robot, config.columns), robot, config, progress)
    wanted = "suspended" if config.suspended else "fit_load" if config.fit_load else ""
    if wanted:
        _require_no_load(path, log, wanted)
    if config.suspended:
        from motorprior.simulation.suspended_load import require_fixed_base

        require_fixed_base(log, robot, path, "suspended")
    period = config.period or (robot.physics_dt if wanted else None)
    log, gaps = begin_at_gaps(log, period or 0.0)
    for told in filter(None, (gaps, taken_for_granted(path, config.columns))):
        progress.note(f"{path}: {told}")
    if period is None:
        return log
    if not wanted:
        return resample(log, period)
    return with_loads_on_grid(log, robot, period) if config.suspended else _bare(log, period)


def _note_signs(path: Path, log: MotorLog, robot: Robot, progress: Progress) -> None:
    """Warn where the loads of the model are those of other signs of the joints."""
    from motorprior.simulation.suspended_load import gravity_torque

    gravity = gravity_torque(log, robot)
    for finding in [] if gravity is None else signs(log, gravity):
        progress.note(f"{WARNING}{path}: {finding.message} -> {finding.remedy}")


def with_loads_on_grid(log: MotorLog, robot: Robot, period: float) -> MotorLog:
    """The log on a grid, as `smooth_on_grid`, with the loads of a robot whose base is held, as `with_loads`."""
    from motorprior.simulation.suspended_load import with_loads

    return with_loads(smooth_on_grid(log, period), robot)


def _bare(log: MotorLog, period: float) -> MotorLog:
    from motorprior.identification.load_fit import require_torque

    require_torque(log)
    return smooth_on_grid(log, period)


def _require_no_load(path: Path, log: MotorLog, wanted: str) -> None:
    for name in ("load_inertia", "external_torque", "load_stiffness"):
        if getattr(log, name) is not None:
            problem = f"{wanted}: it says its load itself ({name})"
            raise ConfigError(problem, where=path, remedy=f"leave {wanted} out", argument=wanted)


def _robot_run(path: Path, robot: Robot, config: LogsImport) -> MotorLog:
    if config.period is None and not config.suspended:
        return read_log(path, robot)
    period = config.period or robot.physics_dt
    if not config.suspended:
        return read_robot_run(path, robot, period=period)
    from motorprior.simulation.suspended_load import with_loads

    return with_loads(read_robot_run(path, robot, (Mode.EXCITE,), period), robot)


def _with_what_is_stated(log: MotorLog, robot: Robot, config: LogsImport, progress: Progress) -> MotorLog:
    """The log with the gains, the registers of the firmware and the conditions that the user states."""
    firmware = {name: getattr(config, name) for name in FIRMWARE if getattr(config, name) is not None}
    found, lines = with_stated(log, _gains(config), firmware, _conditions(config), robot)
    for told in lines:
        progress.note(f"{log.source}: {told}")
    return found


def smooth_on_grid(log: MotorLog, period: float) -> MotorLog:
    """The log at steps of ``period`` [s], its commands held, its angles splines through smoothed readings.

    Velocities are the splines' own: recorded ones are often filtered, and loads need accelerations.
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
