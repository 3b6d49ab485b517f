"""The log doctor: checks whether motors can be identified from a log.

A check is a function of a log that yields findings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from motorprior.logs.doctor import excitation, readings, response, signs, units
from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

Check: TypeAlias = Callable[[MotorLog], Iterator[Finding]]
# The checks of jumps and motion need a correct clock and correct units; the checks of motion need angles without jumps.
BASIC: tuple[Check, ...] = (readings.rate, readings.gaps, readings.repeats, units.speeds, units.ranges)
MOTION: tuple[Check, ...] = (
    excitation.excitation, excitation.dead, response.copied, response.velocity,
)  # fmt: skip
# Checks of the window in which a joint's command travels farthest.
PER_JOINT: tuple[Check, ...] = (
    response.tracking, response.proportion, response.saturation, signs.torque_sign,
)  # fmt: skip


def check_log(log: MotorLog, robot: Robot | None = None) -> LogReport:
    """Check a log.

    Args:
        log: the log; it must pass `checked`.
        robot: of the log; gives limits of the joints, and gravity if its base was suspended or is fixed.

    Returns:
        The findings, errors first.

    Raises:
        LogError: the log fails `checked`.
    """
    log = checked(log, where=log.source)
    limits = None if robot is None else robot.limits_of(log.joint_names)
    of_robot = () if limits is None else (partial(units.outside_limits, limits=limits),)
    stages: list[Sequence[Check]] = [(partial(units.angle_sizes, limits=limits), *of_robot, *BASIC)]
    stages += [(readings.jumps,), (*MOTION, _each_joint)]
    stages += [] if robot is None else [(partial(signs.gravity_signs, robot=robot),)]
    findings: list[Finding] = []
    for checks in stages:  # an error in a stage makes the later ones meaningless
        if LogReport(tuple(findings)).usable:
            findings += [finding for check in checks for finding in check(log)]
    order = ("error", "warning", "info")
    return LogReport(tuple(sorted(findings, key=lambda finding: order.index(finding.severity))))


def _each_joint(log: MotorLog) -> Iterator[Finding]:
    """Findings of PER_JOINT, with their rows in the log."""
    for column in excitation.excited_joints(log):
        window, joint = excitation.excited_window(log, column), log.joint_names[column]
        if window is None:
            message = f"{joint} moves in no window long enough to check its response"
            remedy = f"record at least {excitation.MIN_ROWS} rows of motion without a gap"
            yield Finding("warning", "tracking", 0.0, message, remedy, joint, 0)
            continue
        rows, grid = window
        for finding in (finding for check in PER_JOINT for finding in check(grid)):
            time = grid.time[finding.row or 0] - 1e-6 * grid.period
            yield replace(finding, row=int(rows.start + np.searchsorted(log.time[rows], time)))
