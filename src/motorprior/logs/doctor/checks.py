"""The log doctor: is this log fit to identify motors from, and what should be done to it first?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.doctor import (
    clock_checks,
    coverage_checks,
    gravity_checks,
    joint_checks,
    jump_checks,
    load_checks,
    response_checks,
    sensor_checks,
    stuck_checks,
    torque_checks,
    unit_checks,
)
from motorprior.logs.doctor.excited_stretch import excited_stretches
from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.doctor.gravity_checks import Gravity
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked

_ORDER = {"error": 0, "warning": 1, "info": 2}


def check_log(log: MotorLog, joint_limits: np.ndarray | None = None, gravity: Gravity | None = None) -> LogReport:
    """Check clock, units, range, sensors, what was covered, how the joints respond, the load and the signs of a log.

    Args:
        log: the log to look at; it must pass `checked`.
        joint_limits: (J, 2) lowest and highest angle of each joint [rad], for example
            ``robot.limits_of(log.joint_names)``, NaN where they are not known, infinite of a joint that turns
            on and on; None if none is known.
        gravity: torque of gravity on the joints at angles of theirs, as
            `motorprior.simulation.suspended_load.gravity_torque` has it; None where it is not known.

    Returns:
        Findings, errors first, each with what was measured, its bound and a remedy; ``usable`` where there is no error.

    Raises:
        LogError: the log breaks a rule of `checked`, or the limits have another shape or order.
    """
    log = checked(log, where=log.source)
    limits = None if joint_limits is None else _checked_limits(log, joint_limits)
    findings = [
        *clock_checks.rate(log),
        *clock_checks.jitter(log),
        *clock_checks.gaps(log),
        *clock_checks.repeats(log),
        *clock_checks.stale_joint(log),
        *unit_checks.units(log, limits),
        *unit_checks.angles(log),
        *unit_checks.torques(log),
        *load_checks.stated(log),
    ]
    if limits is not None:
        findings += joint_checks.limits(log, limits)
    for further in (jump_checks.jumps, _statistics):  # of damaged numbers they say nothing
        if not any(finding.severity == "error" for finding in findings):
            findings += further(log)
    if gravity is not None and not any(finding.severity == "error" for finding in findings):
        findings += gravity_checks.signs(log, gravity)
    findings.sort(key=lambda finding: _ORDER[finding.severity])
    return LogReport(log.source, log.num_rows, log.num_joints, log.duration, tuple(findings))


def _statistics(log: MotorLog) -> list[Finding]:
    stretches = excited_stretches(log)
    of_load, judged = torque_checks.torque_and_load(log)
    followed = {joint: response_checks.best_followed(parts) for joint, parts in stretches.items()}
    found = [
        *joint_checks.constant_channels(log),
        *joint_checks.excitation(log),
        *stuck_checks.dead(log),
        *stuck_checks.saturation(log, {joint: seen.servo_lag for joint, (seen, _) in followed.items()}),
        *sensor_checks.quantisation(log),
        *sensor_checks.torque_without_sign(log),
        *response_checks.copied(log),
        *response_checks.velocity(log),
        *coverage_checks.turns(log),
        *of_load,
        *load_checks.load_given(log),
    ]
    for joint, parts in stretches.items():
        found += response_checks.tracking(*followed[joint])
        found += [] if joint in judged else sensor_checks.torque_sign(parts[0])
        found += coverage_checks.coverage(parts)
    return found + joint_checks.not_judged(log, tuple(stretches))


def require_plausible_angles(log: MotorLog, where: str | Path) -> None:
    """Refuse angles that no joint can have, before anyone computes with them.

    Raises:
        LogError: names the row of the largest angle beyond four turns.
    """
    for finding in unit_checks.sizes(log):
        if finding.severity == "error":
            raise LogError(finding.message, where=where, remedy=finding.remedy)


def _checked_limits(log: MotorLog, joint_limits: np.ndarray) -> np.ndarray:
    limits = np.asarray(joint_limits, dtype=np.float64)
    unknown = np.isnan(limits).all(axis=-1)
    if limits.shape != (log.num_joints, 2) or not np.all(unknown | (limits[:, 0] < limits[:, 1])):
        raise LogError(
            f"joint limits of shape {limits.shape}, expected ({log.num_joints}, 2) with lowest < highest",
            remedy="give one row (lowest, highest) [rad] per joint of the log",
        )
    return limits
