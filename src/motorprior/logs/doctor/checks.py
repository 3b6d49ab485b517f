"""The log doctor: checks whether motors can be identified from a log. A check is a function that yields findings."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from motorprior.logs.doctor import readings, response, signs
from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.logs.operations import excited_joints
from motorprior.robots.robot import Robot

# where a joint's command travels farthest
PER_JOINT = (response.tracking, response.saturation, signs.torque_sign)


def check_log(log: MotorLog, robot: Robot | None = None) -> LogReport:
    """Findings about a log, errors first; raises LogError if it does not pass `checked`.

    ``robot`` gives limits of the joints, and gravity if its base was suspended or is fixed.
    """
    log = checked(log)
    found = []
    # jumps need a correct clock and correct units, checks of motion need angles without jumps
    stages = (
        (readings.angle_limits(log, robot), *(check(log) for check in readings.CHECKS)),
        (readings.jumps(log),),
        (*(check(log) for check in response.CHECKS), _each_joint(log)),
        (signs.gravity_signs(log, robot),) if robot else (),
    )
    for checks in stages:
        if LogReport(tuple(found)).usable:
            found += [finding for check in checks for finding in check]
    order = ("error", "warning", "info")
    return LogReport(tuple(sorted(found, key=lambda finding: order.index(finding.severity))))


def _each_joint(log: MotorLog) -> Iterator[Finding]:
    windows: dict[int, tuple[slice, MotorLog]] = {}
    found: dict[int, list[Finding]] = {}
    for column in excited_joints(log).tolist():
        window = response.excited_window(log, column)
        joint = log.joint_names[column]
        if window is None:
            message = f"{joint} moves in no window long enough to check its response"
            remedy = f"record at least {response.MIN_ROWS} rows of motion without a gap"
            yield Finding("warning", "tracking", 0.0, message, remedy, joint)
            continue
        windows[column] = window
        found[column] = [finding for check in PER_JOINT for finding in check(window[1])]
    # The first finding is that of `response.tracking`. Exchanged joints do not follow their own
    # commands.
    late = [column for column in found if found[column][0].severity != "info"]
    followed = {
        column: response.followed_joint(log, *windows[column], list(found)) for column in late
    }
    for column in late if any(followed.values()) else ():
        finding = found[column][0]
        other = followed[column]
        # else two joints may have been read from one
        exchanged = other in [log.joint_names[each] for each in late]
        is_order = other and finding.remedy != response.OTHER_SIGN
        if other:
            message = (
                f"{finding.joint} follows the command of {other}, not its own; {finding.message}"
            )
            finding = replace(
                finding, severity="error" if exchanged else finding.severity, message=message
            )
        # an apparent sign error may be one of order, too
        if is_order or finding.remedy == response.OTHER_SIGN:
            finding = replace(
                finding, remedy=response.OTHER_ORDER if is_order and exchanged else response.COMPARE
            )
        found[column][0] = finding
    for column, findings in found.items():
        rows, grid = windows[column]
        for finding in findings:
            time = grid.time[finding.row] - 1e-6 * grid.period
            yield replace(finding, row=int(rows.start + np.searchsorted(log.time[rows], time)))
