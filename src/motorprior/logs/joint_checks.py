"""Checks of each joint's channels: units, range, and whether it was moved at all."""

from __future__ import annotations

import numpy as np

from motorprior.logs.findings import Finding
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog

MAX_ANGLE = 2.0 * np.pi
WILD_ANGLE = 100.0
"""[rad]; no joint turns so far: a damaged number, and no unit or unwrapping makes sense of it."""
WILD = {"joint_vel": 1e4, "joint_torque": 1e5, "external_torque": 1e5, "load_inertia": 1e5}
"""Sizes [SI] that these channels of no motor have."""
EXCITED_STD = 1e-3
STUCK_RATIO = 0.1
WILD_RATIO = 3.0
"""No servo moves so many times its command: other units."""
ANGLES = ("position_target", "joint_pos")
_CHANGING = ("joint_pos", "joint_vel", "joint_torque")


def units(log: MotorLog) -> list[Finding]:
    """Angles beyond one turn: degrees, or an encoder that wrapped. Errors: beyond 100 rad, and what is WILD."""
    found = []
    for channel in ANGLES:
        size = np.abs(getattr(log, channel))
        for column, joint in enumerate(log.joint_names):
            row = int(np.argmax(size[:, column]))
            if size[row, column] > MAX_ANGLE:
                found.append(_unit_finding(channel, joint, row, float(size[row, column])))
    for channel, most in WILD.items():
        values = getattr(log, channel)
        if values is not None and np.abs(values).max() > most:
            row, column = np.unravel_index(np.argmax(np.abs(values) > most), values.shape)
            value, joint = float(values[row, column]), log.joint_names[column]
            message = f"{channel}/{joint} is {value:.4g} {JOINT_SERIES[channel]} in row {row}, beyond {most:g}"
            remedy = "remove the row, or convert to SI units"
            found.append(Finding("error", "units", value, most, message, remedy, joint, int(row)))
    return found


def _unit_finding(channel: str, joint: str, row: int, size: float) -> Finding:
    described = f"{channel}/{joint} is {size:.4g} rad in row {row}"
    if size > WILD_ANGLE:
        remedy = "remove the row, or copy the log again; convert degrees to rad"
        return Finding(
            "error", "units", size, WILD_ANGLE, f"{described}, beyond {WILD_ANGLE:g} rad", remedy, joint, row
        )
    remedy = "convert degrees to rad, or unwrap the angle"
    return Finding("warning", "units", size, MAX_ANGLE, f"{described}, beyond one turn", remedy, joint, row)


def limits(log: MotorLog, joint_limits: np.ndarray) -> list[Finding]:
    """Angles outside the limits; ``joint_limits`` (J, 2) [rad]."""
    found = []
    for channel in ANGLES:
        angle = getattr(log, channel)
        excess = np.maximum(joint_limits[:, 0] - angle, angle - joint_limits[:, 1])
        for column, joint in enumerate(log.joint_names):
            row = int(np.argmax(excess[:, column]))
            if excess[row, column] > 0.0:
                value = float(angle[row, column])
                bound = float(joint_limits[column, int(value > joint_limits[column, 1])])
                message = f"{channel}/{joint} is {value:.4g} rad in row {row}, its limit is {bound:.4g} rad"
                remedy = "check the encoder zero, the sign and the joint order"
                found.append(Finding("warning", "limits", value, bound, message, remedy, joint, row))
    return found


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
            remedy = "check the sensor, or leave the joint out"
            severity = "warning" if column in excited else "info"
            found.append(Finding(severity, "constant", value, None, message, remedy, joint, row=0))
    return found


def excited_joints(log: MotorLog) -> np.ndarray:
    """Indices of the joints whose command has a standard deviation above 1 mrad."""
    return np.flatnonzero(np.std(log.position_target, axis=0) > EXCITED_STD)


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
            remedy = "check power, homing and the joint order"
            found.append(Finding("warning", "excitation", ratio, STUCK_RATIO, message, remedy, joint, row=0))
        elif motion[column] > WILD_RATIO * command[column]:
            ratio = float(motion[column] / command[column])
            message = f"{joint} moves {ratio:.3g} times its command, more than {WILD_RATIO:g}"
            remedy = "check that command and angle have the same unit"
            found.append(Finding("warning", "excitation", ratio, WILD_RATIO, message, remedy, joint, row=0))
    if not excited.size:
        remedy = "record commands that move the joints"
        found.append(Finding("error", "excitation", 0.0, 1.0, "no joint is excited", remedy, row=0))
    return found
