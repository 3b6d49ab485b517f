"""The log doctor: checks whether motors can be identified from a log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.logs.doctor import clock, excitation, jumps, load, response, saturation, units
from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.doctor.load import Gravity, gravity_signs
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked

# The checks of jumps and motion need a correct clock and correct units; the checks of motion need angles without jumps.
BASIC = (clock.rate, clock.gaps, clock.repeats, units.speeds, units.ranges)
MOTION = (excitation.excitation, saturation.dead, response.copied, response.velocity, load.load)
# Checks of the window in which a joint's command travels farthest.
PER_JOINT = (response.tracking, response.proportion, saturation.saturation, excitation.coverage, load.torque_sign)


def check_log(log: MotorLog, joint_limits: np.ndarray | None = None, gravity: Gravity | None = None) -> LogReport:
    """Check a log.

    Args:
        log: the log; it must pass `checked`.
        joint_limits: (J, 2) lowest and highest angle of each joint [rad], for example
            ``robot.limits_of(log.joint_names)``; NaN if unknown, infinite if unlimited.
        gravity: torque of gravity on the joints, `motorprior.simulation.suspended_load.gravity_torque`.

    Returns:
        The findings, errors first.

    Raises:
        LogError: the log fails `checked`.
    """
    log = checked(log, where=log.source)
    findings = units.angle_sizes(log, joint_limits)
    findings += [] if joint_limits is None else units.outside_limits(log, joint_limits)
    findings += [finding for check in BASIC for finding in check(log)]
    if LogReport(tuple(findings)).usable:
        findings += jumps.jumps(log)
    if LogReport(tuple(findings)).usable:
        findings += [finding for check in MOTION for finding in check(log)]
        findings += [finding for column in excitation.excited_joints(log) for finding in _joint_findings(log, column)]
    if gravity is not None and LogReport(tuple(findings)).usable:
        findings += gravity_signs(log, gravity)
    order = ("error", "warning", "info")
    return LogReport(tuple(sorted(findings, key=lambda finding: order.index(finding.severity))))


def _joint_findings(log: MotorLog, column: int) -> list[Finding]:
    """Findings in the window of a joint, with their rows in the log."""
    window = excitation.excited_window(log, column)
    if window is None:
        joint = log.joint_names[column]
        message = f"{joint} moves in no window long enough to check its response"
        remedy = f"record at least {excitation.MIN_ROWS} rows of motion without a gap"
        return [Finding("warning", "tracking", 0.0, message, remedy, joint, 0)]
    rows, grid = window
    findings = [finding for check in PER_JOINT for finding in check(grid)]
    times = [grid.time[finding.row or 0] - 1e-6 * grid.period for finding in findings]
    places = rows.start + np.searchsorted(log.time[rows], times)
    return [replace(finding, row=int(row)) for finding, row in zip(findings, places, strict=True)]
