"""Prepare a recording for identification: settings, failed reads, gaps, grid, smoothing, loads."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError, LogError, listed
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import Finding, grouped
from motorprior.logs.doctor.readings import failed_reads
from motorprior.logs.doctor.signs import gravity_signs
from motorprior.logs.loads import load_source, with_loads
from motorprior.logs.motor_log import OPERATING_CONDITIONS, MotorLog, checked
from motorprior.logs.operations import resample, smooth_on_grid, split_at_gaps
from motorprior.logs.read_log import Recording
from motorprior.progress import PYTHON_WARNINGS, Note, Progress
from motorprior.robots.robot import Robot

ERRORS_TOPIC = "errors"  # topic of notes about errors of a recording
LOADS_TOPIC = "loads"  # topic of the note that states the source of the loads
PERIOD = 0.002  # sample period of the identification presets for real motors [s]


@dataclass(frozen=True, kw_only=True)
class LogSettings:
    """The grid of a prepared log, and what its recording lacks or states wrongly."""

    period: float | None = PERIOD
    """Time step of the result [s]; None keeps the recorded rows."""
    kp: float | Sequence[float] = ()
    """Proportional gain in `MotorLog.gain_unit`: one for all joints, or one per joint in the order
    of the log. It overrides the logged gain; empty keeps that."""
    kd: float | Sequence[float] = ()
    """Derivative gain, in the same form."""
    firmware: Mapping[str, float] = field(default_factory=dict)
    """Registers of `motor_log.FIRMWARE` in SI units; they override the logged registers."""
    operating_conditions: Mapping[str, float] = field(default_factory=dict)
    """Values of `motor_log.OPERATING_CONDITIONS` for all joints and rows; they override the logged
    channels."""
    as_joint: Sequence[str] = ()
    """Names in the robot of the log's joints, in the log's order: a log of a bench becomes a log of
    motors of this robot."""

    def check(self) -> None:
        """Raise `ConfigError` for a period out of range, or an unknown operating condition."""
        if self.period is not None:
            require_number("period", self.period, 1e-6, 1.0)
        for name in self.operating_conditions:
            if name not in OPERATING_CONDITIONS:
                raise ConfigError(
                    f"operating condition {name!r} is unknown",
                    remedy=f"give {' or '.join(OPERATING_CONDITIONS)}",
                    argument="operating_conditions",
                )


DEFAULT_SETTINGS = LogSettings()


def prepare_log(
    recording: Recording,
    robot: Robot | None = None,
    suspended: bool = False,
    settings: LogSettings = DEFAULT_SETTINGS,
    progress: Progress = PYTHON_WARNINGS,
    allow_errors: bool = True,
) -> MotorLog:
    """Apply the settings, leave out failed reads, cut at gaps, put on the grid, and add loads.

    With loads by the robot's model, angles are smoothed as well. Failed reads, gaps, errors that
    `check_log` finds, assumptions of the format, the source of the loads, and joint signs that
    contradict gravity are reported.

    Args:
        recording: the log as it was read.
        robot: the recorded robot; gives the loads.
        suspended: the robot was suspended in the air, level unless the log has its orientation.
        settings: the grid, and what the recording lacks.
        progress: where to report to; by default warnings are Python warnings.
        allow_errors: whether errors that `check_log` finds are reported as warnings, or raised.

    Raises:
        ConfigError: a setting out of its range, another number of gains than joints, joints that
            the robot does not have, or loads that need a robot or a period.
        LogError: the log lacks what loads need, or has a value out of its bounds.
    """
    settings.check()
    period = settings.period
    path = recording.path

    log = _with_joints_of(robot, recording.log, settings.as_joint, path)
    log = _with_settings(log, settings, progress)

    loads = load_source(log, robot, suspended, path)
    needs_model = loads.name == "model" and period is not None
    if suspended and not needs_model:
        raise ConfigError(
            "suspended: loads need a period",
            where=path,
            remedy="give a period, or remove suspended",
            argument="suspended",
        )

    if not recording.is_on_grid:
        log, notes = cleaned(log, str(path), period or 0.0)
        if not allow_errors:
            _raise_errors(notes, path)
        for note in notes:
            progress.report(note)
    for warning in recording.warnings:
        progress.warn(f"{path}: {warning}")
    if recording.assumption:
        progress.note(f"{path}: {recording.assumption}")
    if period is not None and not recording.is_on_grid:
        log = smooth_on_grid(log, period) if needs_model else resample(log, period)

    if robot is not None:
        progress.report(Note("info", f"{path}: {loads}", LOADS_TOPIC))
    if robot is None or not needs_model:
        return log

    log = with_loads(log, robot)
    for finding in gravity_signs(log, robot):
        progress.warn(f"{path}: {finding}")
    return log


def _with_joints_of(
    robot: Robot | None, log: MotorLog, as_joint: Sequence[str], path: Path
) -> MotorLog:
    """The log with the names, classes and motors of the robot's joints."""
    if robot is None:
        if as_joint:
            raise ConfigError("as_joint without a robot", remedy="give robot", argument="as_joint")
        return log

    if as_joint:
        log = _renamed(log, robot, tuple(as_joint), path)
    elif log.robot != robot.name and set(log.joint_names).isdisjoint(robot.joint_names):
        raise _wrong_joints(
            f"its joints {listed(log.joint_names, 8)} are none of {robot.name}'s", robot, path
        )

    if not set(log.joint_names) <= set(robot.joint_names):
        return log
    classes = dict(zip(robot.joint_names, robot.joint_classes, strict=True))
    log = replace(log, given_classes=tuple(classes[name] for name in log.joint_names))
    if not robot.motor_models:
        return log
    models = dict(zip(robot.joint_names, robot.motor_models, strict=True))
    return replace(log, motor_models=tuple(models[name] for name in log.joint_names))


def _renamed(log: MotorLog, robot: Robot, as_joint: tuple[str, ...], path: Path) -> MotorLog:
    """The log as one of joints of the robot."""
    names = set(as_joint)
    if (
        len(as_joint) != log.num_joints
        or len(names) != len(as_joint)
        or not names <= set(robot.joint_names)
    ):
        problem = f"as_joint {', '.join(as_joint)} does not name {log.num_joints} different joints"
        raise _wrong_joints(f"{problem} of {robot.name}", robot, path)
    return checked(replace(log, joint_names=as_joint, robot=robot.name))


def _wrong_joints(problem: str, robot: Robot, path: Path) -> ConfigError:
    names = ", ".join(robot.joint_names)
    remedy = f"state which they are by as_joint, such as {robot.joint_names[0]}, of {names}"
    return ConfigError(problem, where=path, remedy=remedy, argument="as_joint")


def _with_settings(log: MotorLog, settings: LogSettings, progress: Progress) -> MotorLog:
    """The log with the gains, registers and operating conditions of the settings."""
    shape = log.joint_pos.shape
    values: dict[str, Any] = {"firmware": {**log.firmware, **settings.firmware}}

    for name, gain in (("kp", settings.kp), ("kd", settings.kd)):
        gains = np.ravel(gain)
        if gains.size not in (0, 1, log.num_joints):
            problem = f"{name}: {gains.size} gains for {log.num_joints} joints"
            raise ConfigError(problem, remedy="give one, or one per joint", argument=name)
        if gains.size > 1:
            pairs = zip(log.joint_names, gains.tolist(), strict=True)
            text = ", ".join(f"{joint} {value:g}" for joint, value in pairs)
            progress.note(f"{log.source}: {name}: {text}")
        if gains.size:
            logged = getattr(log, f"logged_{name}")
            if logged is not None and np.any(logged != logged[0]):
                progress.warn(
                    f"{log.source}: {name} of the recording changes from {logged.min():.4g} to "
                    f"{logged.max():.4g}, and {name} = {gains.max():.4g} replaces it in every row "
                    f"-> leave {name} out to keep the logged gains"
                )
            values[f"logged_{name}"] = np.broadcast_to(gains, shape)

    for name, value in settings.operating_conditions.items():
        values[name] = np.full(shape, value)
    return checked(replace(log, **values))


def cleaned(log: MotorLog, name: str, period: float = 0.0) -> tuple[MotorLog, list[Note]]:
    """The log without rows in which a read failed, with a segment after every gap; and notes.

    The notes begin with the ``name`` of the log. They are about both, errors that `check_log`
    finds, angles that precede their command, and angles of another size than their command.

    Raises:
        LogError: as `split_at_gaps`; a rate that no motor is recorded at; or a segment that has
            fewer than 2 rows without failed reads.
    """
    notes = []
    failed = failed_reads(log)
    failed_rows = np.asarray(failed.any(axis=1))
    if failed_rows.any():
        counts = zip(log.joint_names, failed.sum(axis=0), strict=True)
        text = listed([f"{joint} {count}" for joint, count in counts if count], 8)
        problem = f"{failed_rows.sum()} rows in which a read failed are left out"
        notes.append(Note("warning", f"{name}: {problem} ({text})"))
        log = checked(log.rows(~failed_rows))

    log, gaps = split_at_gaps(log, period)

    findings = check_log(log).findings
    slow = {
        finding.joint: 1e-3 * finding.value
        for finding in findings
        if finding.check == "command_rate" and finding.joint is not None
    }
    for finding in grouped(findings):
        if finding.severity == "error" and finding.check == "rate":
            raise LogError(finding.message, where=log.source, remedy=finding.remedy)
        topic = ERRORS_TOPIC if finding.severity == "error" else ""
        if topic or _is_doubtful(finding):
            notes.append(Note("warning", f"{name}: {finding}", topic))
    if gaps:
        notes.append(Note("info", f"{name}: {gaps}"))
    if slow:
        log = replace(log, slow_commands=slow)
    return log, notes


def _raise_errors(notes: Sequence[Note], path: Path) -> None:
    """Raise `LogError` if any of the notes is about an error."""
    errors = [note.text.removeprefix(f"{path}: ") for note in notes if note.topic == ERRORS_TOPIC]
    if errors:
        count = f"{len(errors)} errors: " if len(errors) > 1 else ""
        remedy = (
            "mend the recording or its column map (`motorprior logs check` lists all findings), or "
            "load it with allow_errors=True"
        )
        raise LogError(count + "; ".join(errors), where=path, remedy=remedy)


def _is_doubtful(finding: Finding) -> bool:
    """Whether columns may be wrong, or commands and motion do not belong together."""
    is_early = finding.check == "tracking" and finding.value < 0.0
    doubtful = ("excitation", "command_rate", "interpolated", "torque_off")
    doubtful += ("velocity_target", "commanded_torque")
    is_doubtful = finding.check in doubtful or is_early
    return finding.severity == "warning" and is_doubtful
