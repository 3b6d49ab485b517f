"""Checks of units: implausible angles and speeds, joint limits, and ranges to compare with the robot."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.readings import TURN
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.settings_text import settings_text

ANGLES = ("position_target", "joint_pos")
MAX_TURNS = 4.0  # of a joint without known limits
MAX_SPEED = 100.0  # no geared joint is so fast [rad/s]
_DEGREES = f'convert them in the file, or state their unit {IN_MAP}: angle = "deg", "turn" or "tick"'


def angle_sizes(log: MotorLog, limits: np.ndarray | None = None) -> Iterator[Finding]:
    """Angles beyond one turn (warning) or four turns (error), unless ``limits`` allow them.

    Args:
        log: the log.
        limits: (J, 2) lowest and highest angle [rad], infinite if unlimited, NaN if unknown.
    """
    bounds = np.zeros((log.num_joints, 2)) if limits is None else np.where(np.isnan(limits), 0.0, limits)
    for channel in ANGLES:
        for joint, angle, bound in zip(log.joint_names, getattr(log, channel).T, bounds, strict=True):
            row, reach, way = int(np.argmax(np.abs(angle))), float(np.abs(bound).max()), float(np.ptp(angle))
            size, message = abs(float(angle[row])), f"{channel}/{joint} is {angle[row]:.4g} rad in row {row}"
            if size > max(MAX_TURNS * TURN, reach):
                message += f", beyond {max(MAX_TURNS, reach / TURN):.3g} turns"
                remedy = f"if it is one row, delete it; else {_DEGREES}; or give the robot, if its limits are so wide"
                yield Finding("error", "units", size, message, remedy, joint, row)
            elif size > max(TURN, reach) or way > max(TURN, float(np.ptp(bound))):
                message += f"; it moves over {way:.4g} rad: more than one turn"
                remedy = f"if these are not rad, {_DEGREES}; if the encoder wrapped, unwrap the column (numpy.unwrap)"
                yield Finding("warning", "units", size, message, remedy, joint, row)


def speeds(log: MotorLog) -> Iterator[Finding]:
    """Speeds above 100 rad/s, of angles or joint_vel: an error if frequent, a warning for single readings of joint_vel.

    The speed of an angle counts where the next one is as high in the same direction, so jumps and segment ends do not.
    """
    width = max(1, round(0.01 / log.period))  # over a single row an encoder step would look fast
    rows = np.arange(0, log.num_rows, width)
    lengths = np.maximum(np.diff(log.time[rows]), width * log.period)
    for column, joint in enumerate(log.joint_names):
        speed = np.diff(log.joint_pos[rows, column]) / lengths
        lasting = np.where(speed[1:] * speed[:-1] > 0.0, np.minimum(*np.abs([speed[1:], speed[:-1]])), 0.0)
        places = rows[np.flatnonzero(lasting > MAX_SPEED)]
        if len(places) > 5:
            message = f"joint_pos/{joint} moves at up to {lasting.max():.4g} rad/s, faster than {MAX_SPEED:g} rad/s"
            yield Finding("error", "units", float(lasting.max()), message, _DEGREES, joint, int(places[0]))
        speed = np.abs(np.zeros(1) if log.joint_vel is None else log.joint_vel[:, column])
        if speed.max() > MAX_SPEED:
            fast, row = float(np.mean(speed > MAX_SPEED)), int(np.argmax(speed > MAX_SPEED))
            message = f"joint_vel/{joint} is up to {speed.max():.4g} rad/s, above {MAX_SPEED:g} rad/s in "
            message += f"{100 * fast:.2g} % of the rows, first in row {row}"
            remedy = f'convert it in the file, or state its unit {IN_MAP}: velocity = "deg/s" or "rpm"'
            remedy += "; if single reads failed, delete these rows, or leave joint_vel out"
            severity = "error" if fast > 0.02 else "warning"  # failed reads are rare
            yield Finding(severity, "units", float(speed.max()), message, remedy, joint, row)


def outside_limits(log: MotorLog, limits: np.ndarray) -> Iterator[Finding]:
    """Angles outside the limits of the robot (J, 2) [rad], and joints whose limits are unknown (NaN)."""
    unknown = [joint for joint, bounds in zip(log.joint_names, limits, strict=True) if np.isnan(bounds).any()]
    if unknown:
        message = f"the robot has no limits for {', '.join(unknown)}"
        remedy = f"rename the joints in the file, or {IN_MAP} by name; or give the robot that was recorded"
        yield Finding("info", "limits", len(unknown), message, remedy, row=0)
    for channel in ANGLES:
        for joint, angle, (low, high) in zip(log.joint_names, getattr(log, channel).T, limits, strict=True):
            row = int(np.argmax(np.maximum(low - angle, angle - high)))
            if angle[row] < low or angle[row] > high:
                message = f"{channel}/{joint} is {angle[row]:.4g} rad in row {row}, outside {low:.4g} to {high:.4g} rad"
                remedy = f"check the encoder's zero, sign and joint order; correct them in the file, or {IN_MAP}"
                yield Finding("warning", "limits", float(angle[row]), message, remedy, joint, row)


def ranges(log: MotorLog) -> Iterator[Finding]:
    """For comparison with the robot (info): ranges of the angles in degrees, and logged gains and registers."""
    low, high = (np.rad2deg(bound(log.joint_pos, axis=0)).tolist() for bound in (np.min, np.max))
    spans = [f"{joint} {a:.4g}..{b:.4g}" for joint, a, b in zip(log.joint_names, low, high, strict=True)]
    gains = settings_text(log) or "no gain, register or posture"
    yield Finding("info", "angles", max(map(abs, low + high)), f"angles in degrees: {', '.join(spans)}", row=0)
    yield Finding("info", "settings", 0.0, f"the log states {gains}", row=0)
