"""Checks of each joint's channels: range, and whether it was moved at all."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.unit_checks import ANGLES
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog

EXCITED_STD = 1e-3
STUCK_RATIO = 0.1
WILD_RATIO = 3.0
"""No servo moves so many times its command: other units."""
_DEGREE = np.pi / 180.0
"""About the ratio of an angle in rad to its command in degrees."""
_ALIKE = 0.2
_UNITS = (
    f"if command and angle have different units, convert one of them in the file, or say so {IN_MAP}: "
    'angle = "deg" in [joints.….position_target] or [joints.….joint_pos]'
)
_CHANGING = ("joint_pos", "joint_vel", "joint_torque")


def limits(log: MotorLog, joint_limits: np.ndarray) -> list[Finding]:
    """Angles outside the limits, and joints without any; ``joint_limits`` (J, 2) [rad], NaN where not known."""
    found = _without_limits(log, joint_limits)
    for channel in ANGLES:
        angle = getattr(log, channel)
        excess = np.maximum(joint_limits[:, 0] - angle, angle - joint_limits[:, 1])
        for column, joint in enumerate(log.joint_names):
            row = int(np.argmax(excess[:, column]))
            if excess[row, column] > 0.0:
                value = float(angle[row, column])
                bound = float(joint_limits[column, int(value > joint_limits[column, 1])])
                message = f"{channel}/{joint} is {value:.4g} rad in row {row}, its limit is {bound:.4g} rad"
                remedy = (
                    "check the encoder's zero, the sign and the order of the joints; correct them in the file, or "
                    f"{IN_MAP} by zero, sign and name"
                )
                found.append(Finding("warning", "limits", value, bound, message, remedy, joint, row))
    return found


def _without_limits(log: MotorLog, joint_limits: np.ndarray) -> list[Finding]:
    unknown = np.flatnonzero(np.isnan(joint_limits).any(axis=1))
    if not unknown.size:
        return []
    names = ", ".join(log.joint_names[column] for column in unknown)
    message = f"the robot has no limits for {names}: {unknown.size} of {log.num_joints} joints are not checked"
    remedy = f"name them as the robot does, in the file, or {IN_MAP} by name; or give the robot that was recorded"
    return [Finding("info", "limits", float(unknown.size), None, message, remedy, row=0)]


def constant_channels(log: MotorLog) -> list[Finding]:
    """Measured channels that never change; of a joint that was not to move, that is only good to know."""
    found, excited = [], excited_joints(log)
    for channel in _CHANGING:
        values = getattr(log, channel)
        if values is None:
            continue
        for column in np.flatnonzero(np.ptp(values, axis=0) == 0.0):
            joint, value = log.joint_names[column], float(values[0, column])
            message = f"{channel}/{joint} is {value:.6g} {JOINT_SERIES[channel]} in every row"
            what = "the joint's table [joints.…]" if channel == "joint_pos" else channel
            remedy = f"check the sensor; where a column map names the channel, {what} can be removed from the map"
            severity = "warning" if column in excited else "info"
            found.append(Finding(severity, "constant", value, None, message, remedy, joint, row=0))
    return found


def excited_joints(log: MotorLog) -> np.ndarray:
    """Indices of the joints whose command has a standard deviation above 1 mrad."""
    return np.flatnonzero(np.std(log.position_target, axis=0) > EXCITED_STD)


def not_judged(log: MotorLog, judged: tuple[str, ...]) -> list[Finding]:
    """Excited joints that are not among those ``judged``: all parts in which their commands move are too short."""
    left = [log.joint_names[column] for column in excited_joints(log) if log.joint_names[column] not in judged]
    message = "too short to judge by how it follows its command, its torque's sign and what it covers"
    remedy = "record at least 20 rows of motion without a gap"
    return [Finding("warning", "tracking", 0.0, None, f"{joint}: {message}", remedy, joint, row=0) for joint in left]


def joints_at_rest(log: MotorLog) -> tuple[str, ...]:
    """Names of the joints whose angle has a standard deviation of no more than 1 mrad."""
    at_rest = np.flatnonzero(np.std(log.joint_pos, axis=0) <= EXCITED_STD)
    return tuple(log.joint_names[column] for column in at_rest)


def excitation(log: MotorLog) -> list[Finding]:
    """Joints that were not commanded to move, joints that were and did not, and those that move far more."""
    command, motion = np.std(log.position_target, axis=0), np.std(log.joint_pos, axis=0)
    excited = excited_joints(log)
    found = []
    for column, joint in enumerate(log.joint_names):
        if column not in excited:
            message = f"{joint} is not excited: its command varies by {1e3 * command[column]:.3f} mrad"
            found.append(
                Finding("info", "excitation", float(command[column]), EXCITED_STD, message, joint=joint, row=0)
            )
        elif motion[column] < STUCK_RATIO * command[column]:
            ratio = float(motion[column] / command[column])
            message = f"{joint} moves {100 * ratio:.1f} % of its command, less than {100 * STUCK_RATIO:g} %"
            remedy = (
                "check power, homing and the order of the joints" if abs(ratio - _DEGREE) > 0.2 * _DEGREE else _UNITS
            )
            found.append(Finding("warning", "excitation", ratio, STUCK_RATIO, message, remedy, joint, row=0))
        elif motion[column] > WILD_RATIO * command[column]:
            ratio = float(motion[column] / command[column])
            message = f"{joint} moves {ratio:.3g} times its command, more than {WILD_RATIO:g}"
            found.append(Finding("warning", "excitation", ratio, WILD_RATIO, message, _UNITS, joint, row=0))
    if not excited.size:
        remedy = "record commands that move the joints"
        found.append(Finding("error", "excitation", 0.0, 1.0, "no joint is excited", remedy, row=0))
    return found
