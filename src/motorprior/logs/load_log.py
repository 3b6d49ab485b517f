"""Read a recording in any format and prepare it: settings, failed reads, gaps, grid, loads."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError, LogError, listed
from motorprior.logs.column_map import ColumnMap
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import grouped
from motorprior.logs.doctor.readings import failed_reads
from motorprior.logs.doctor.signs import gravity_signs
from motorprior.logs.loads import LOADS, require_fixed_base, with_loads
from motorprior.logs.motor_log import OPERATING_CONDITIONS, MotorLog, checked
from motorprior.logs.operations import begin_at_gaps, resample, smooth_on_grid
from motorprior.logs.read_log import read_log, reader_of
from motorprior.progress import WARNED, Note, Progress
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot

PERIOD = 0.002  # sample period of the identification presets for real motors [s]


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

    Rows in which a read failed are left out. A segment begins after every gap. Both, errors that
    `check_log` finds, assumptions of the format, and joint signs that contradict gravity are
    reported.

    Args:
        path: as in `read_log`.
        columns: as in `read_log`.
        robot: the recorded robot, its name or its .toml file; gives the loads, and the joints of
            formats that do not name them.
        suspended: the robot was suspended with a level body, or has a fixed base: smooth the
            readings and compute the loads of the motors from the model of ``robot``. Otherwise
            loads are those of the log, if it has any.
        period: time step of the result [s]; None keeps the recorded rows.
        kp: proportional gain during the log, in its unit of gains: one for all joints, or one per
            joint in the order of the robot, or of ``columns`` without one. Overrides the log and
            ``columns``.
        kd: derivative gain, likewise.
        firmware: registers of `motor_log.FIRMWARE`, in SI units; they override those of the log.
        conditions: some of `motor_log.OPERATING_CONDITIONS`, for all joints and rows; they override
            those of the log.
        as_joint: names of the joints of ``robot`` for those of the log, in its order: the log, for
            example of a bench, is then one of motors of this robot.
        progress: where to report to; by default warnings are Python warnings.

    Raises:
        ConfigError: a period out of range, another number of gains, or loads without a robot or
            period, or for a log that has loads; joints that are none of the robot's, without
            ``as_joint``.
        LogError: the log cannot be read, lacks what loads need, or a given value is out of its
            bounds.
        ArtifactError: a bad column map or robot.
    """
    robot = None if robot is None else as_robot(robot)
    path = Path(path)
    reader = reader_of(path, columns is not None)
    model = robot if suspended else None
    if period is not None:
        require_number("period", period, 1e-6, 1.0)
    if suspended and (robot is None or period is None):
        problem = "suspended: no model for the loads"
        remedy = "give robot, its .toml file (docs/your-robot.md)"
        raise ConfigError(problem, where=path, remedy=f"{remedy}, and a period", argument="robot")
    on_grid = None if period is None or columns else reader.on_grid
    log = (
        on_grid(path, robot, period or 0.0, suspended)
        if on_grid
        else read_log(path, robot, columns)
    )
    log = _of_robot(log, robot, tuple(as_joint), path)
    log = _with_settings(log, kp, kd, firmware, conditions, progress)
    if robot is not None and set(log.joint_names) <= set(robot.joint_names):
        classes = dict(zip(robot.joint_names, robot.joint_classes, strict=True))
        log = replace(log, given_classes=tuple(classes[name] for name in log.joint_names))
    if on_grid is None:
        if model is not None:
            if present := [name for name in LOADS if getattr(log, name) is not None]:
                problem = f"suspended: the log already contains its load ({present[0]})"
                raise ConfigError(
                    problem, where=path, remedy="remove suspended", argument="suspended"
                )
            require_fixed_base(log, model, path)
        log, notes = cleaned(log, str(path), period or 0.0)
        for note in notes:
            progress.report(note)
        if reader.assumption and not columns:
            progress.note(f"{path}: {reader.assumption}")
        if period is not None:
            log = resample(log, period) if model is None else smooth_on_grid(log, period)
    if robot is not None and robot.base == "fixed" and model is None and log.load_inertia is None:
        progress.note(
            f"{path}: no loads -> the base of {robot.name} is fixed: set suspended to compute them"
        )
    if model is not None:
        log = with_loads(log, model)
        for finding in gravity_signs(log, model):
            progress.warn(f"{path}: {finding}")
    return log


def _of_robot(
    log: MotorLog, robot: Robot | None, as_joint: tuple[str, ...], path: Path
) -> MotorLog:
    """The log with joints of the robot, if their names are given."""
    if as_joint and robot is None:
        raise ConfigError("as_joint without a robot", remedy="give robot", argument="as_joint")
    known = robot is not None and (
        log.robot == robot.name or set(log.joint_names) & set(robot.joint_names)
    )
    if robot is None or (known and not as_joint):
        return log
    if len(as_joint) == log.num_joints and len(set(as_joint) & set(robot.joint_names)) == len(
        as_joint
    ):
        return checked(replace(log, joint_names=as_joint, robot=robot.name))
    problem = f"its joints {listed(log.joint_names, 8)} are none of {robot.name}'s"
    if as_joint:
        problem = f"as_joint {', '.join(as_joint)} does not name {log.num_joints} different joints of {robot.name}"
    remedy = f"state which they are by as_joint, such as {robot.joint_names[0]}, of {', '.join(robot.joint_names)}"
    raise ConfigError(problem, where=path, remedy=remedy, argument="as_joint")


def cleaned(log: MotorLog, name: str, period: float = 0.0) -> tuple[MotorLog, list[Note]]:
    """The log without rows in which a read failed, a segment after every gap; and notes on both.

    Notes begin with the ``name`` of the log. Further notes are warnings of the errors that
    `check_log` finds, of angles that precede their command, and of angles of another size.

    Raises:
        LogError: as `begin_at_gaps`; a rate that no motor is recorded at; or a segment that has
            fewer than 2 rows without failed reads.
    """
    failed = failed_reads(log)
    counts = failed.sum(axis=0)
    rows = np.asarray(failed.any(axis=1))
    named = [
        f"{name} {count}" for name, count in zip(log.joint_names, counts, strict=True) if count
    ]
    warnings = (
        [f"{rows.sum()} rows in which a read failed are left out ({listed(named, 8)})"]
        if named
        else []
    )
    log, gaps = begin_at_gaps(checked(log.rows(~rows)) if named else log, period)
    for each in grouped(check_log(log).findings):
        if (each.severity, each.check) == ("error", "rate"):
            raise LogError(each.message, where=log.source, remedy=each.remedy)
        # columns may be exchanged, or in another unit
        is_doubtful = each.severity == "warning" and (
            each.check == "excitation" or (each.check == "tracking" and each.value < 0.0)
        )
        if each.severity == "error" or is_doubtful:
            warnings.append(str(each))
    notes = [Note("warning", f"{name}: {text}") for text in warnings]
    if gaps:
        notes.append(Note("info", f"{name}: {gaps}"))
    return log, notes


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
            progress.note(
                f"{log.source}: {name}: {', '.join(f'{joint} {value:g}' for joint, value in pairs)}"
            )
        if given.size:
            values[f"logged_{name}"] = np.broadcast_to(given, log.joint_pos.shape)
    for name, value in (conditions or {}).items():
        if name not in OPERATING_CONDITIONS:
            remedy = f"give {' or '.join(OPERATING_CONDITIONS)}"
            raise ConfigError(f"condition {name!r}", remedy=remedy, argument="conditions")
        values[name] = np.full(log.joint_pos.shape, value)
    return checked(replace(log, **values))
