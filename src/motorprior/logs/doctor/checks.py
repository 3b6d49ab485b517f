"""The log doctor: checks whether motors can be identified from a log.

A check is a function that yields findings.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import chain
from typing import TypeAlias

import numpy as np

from motorprior.logs.command_modes import commands_angles
from motorprior.logs.doctor import command_signs, commands, readings, response, signs
from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.logs.operations import excited_joints
from motorprior.robots.robot import Robot

Check: TypeAlias = Callable[[MotorLog], Iterable[Finding]]
# checks of the window of a joint in which its command travels farthest; tracking comes first
PER_JOINT: tuple[Check, ...] = (
    response.tracking,
    response.saturation,
    signs.torque_sign,
    commands.command_rate,
    command_signs.velocity_target,
    command_signs.commanded_torque,
)
# checks of the window of a joint on which position targets do not act
WITHOUT_ANGLES = PER_JOINT[3:]
_SEVERITIES = ("error", "warning", "info")


def check_log(log: MotorLog, robot: Robot | None = None) -> LogReport:
    """Findings about a log, errors first; raises LogError if it does not pass `checked`.

    ``robot`` gives limits of the joints, and gravity if its base was suspended or is fixed.
    """
    log = checked(log)
    # jumps need a correct clock and correct units, checks of motion need angles without jumps
    stages = (
        (readings.angle_limits(log, robot), *(check(log) for check in readings.CHECKS)),
        (readings.jumps(log),),
        tuple(check(log) for check in (*response.CHECKS, *commands.CHECKS)),
        (_joint_findings(log),),
        (signs.gravity_signs(log, robot),) if robot else (),
    )

    findings: list[Finding] = []
    for checks in stages:
        if LogReport(tuple(findings)).usable:
            findings += chain.from_iterable(checks)
    findings.sort(key=lambda finding: _SEVERITIES.index(finding.severity))
    return LogReport(tuple(findings))


def _joint_findings(log: MotorLog) -> Iterator[Finding]:
    """Findings of checks about windows of single joints, with rows of the log."""
    windows: dict[int, tuple[slice, MotorLog]] = {}
    findings: dict[int, list[Finding]] = {}
    is_commanded = commands_angles(log)
    for column in excited_joints(log).tolist():
        window = response.excited_window(log, column)
        if window is None:
            joint = log.joint_names[column]
            message = f"{joint} moves in no window long enough to check its response"
            remedy = f"record at least {response.MIN_ROWS} rows of motion without a gap"
            yield Finding("warning", "tracking", 0.0, message, remedy, joint)
            continue
        windows[column] = window
        checks = PER_JOINT if is_commanded[column] else WITHOUT_ANGLES
        findings[column] = [finding for check in checks for finding in check(window[1])]

    tracking = {column: found for column, found in findings.items() if is_commanded[column]}
    _name_followed_joints(log, windows, tracking)

    for column, joint_findings in findings.items():
        rows, grid = windows[column]
        for finding in joint_findings:
            time = grid.time[finding.row] - 1e-6 * grid.period
            row = rows.start + np.searchsorted(log.time[rows], time)
            yield replace(finding, row=int(row))


def _name_followed_joints(
    log: MotorLog,
    windows: dict[int, tuple[slice, MotorLog]],
    findings: dict[int, list[Finding]],
) -> None:
    """State in findings about tracking which other joint's command an angle follows.

    This shows joints that were exchanged.
    """
    doubtful = [column for column in findings if findings[column][0].severity != "info"]
    doubtful_names = [log.joint_names[column] for column in doubtful]
    followed = {
        column: response.followed_joint(log, *windows[column], list(findings))
        for column in doubtful
    }
    if not any(followed.values()):
        return
    for column in doubtful:
        # If the followed joint follows its own command, both angles may have been read from one
        # joint.
        is_exchanged = followed[column] in doubtful_names
        findings[column][0] = _with_followed_joint(
            findings[column][0], followed[column], is_exchanged
        )


def _with_followed_joint(finding: Finding, followed: str, is_exchanged: bool) -> Finding:
    """The finding about tracking, with the joint whose command the angle follows.

    ``followed`` is the name of this joint, or "" if the angle follows no other joint's command.
    """
    if followed:
        finding = replace(
            finding,
            severity="error" if is_exchanged else finding.severity,
            message=f"{finding.joint} follows the command of {followed}, not its own; "
            f"{finding.message}",
        )
        if not finding.is_sign_error and is_exchanged:
            return replace(finding, remedy=response.OTHER_ORDER)
    # what looks like an error of the sign may also be an error of the joint order
    if followed or finding.is_sign_error:
        return replace(finding, remedy=response.COMPARE_JOINTS)
    return finding
