"""Checks of units: sizes that no joint reaches, speeds that no joint has, and what the angles are in degrees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog

ANGLES = ("position_target", "joint_pos")
MAX_ANGLE = 2.0 * np.pi
FEW_TURNS = 8.0 * np.pi
"""[rad]; a joint whose limits nobody told does not turn further than four times."""
WILD_ANGLE = 100.0
"""[rad]; no joint turns so far: a damaged number, and no unit or unwrapping makes sense of it."""
WILD = {
    "joint_vel": 1e4, "joint_torque": 1e5, "external_torque": 1e5, "load_inertia": 1e5, "supply_voltage": 100.0,
    "motor_temperature": 150.0,
}  # fmt: skip
"""Sizes [SI] that these channels of no motor have."""
MAX_SPEED = 100.0
"""[rad/s]; no geared joint is so fast."""
HANDFUL = 5
"""So many rows may be wrong for other reasons than their unit."""
SPEED_SHARE = 1e-3
"""And so large a share of the velocities."""
SPEED_TIME = 0.01
"""Speeds are taken over so long a time [s], or the steps of an encoder that is polled fast would be some."""
_DEGREES = f'convert them in the file, or say what their unit is {IN_MAP}: angle = "deg", "turn" or "tick"'

_UNSURE = f"if these are not rad, {_DEGREES}; if the encoder wrapped, unwrap the column (numpy.unwrap)"


def units(log: MotorLog, joint_limits: np.ndarray | None = None) -> list[Finding]:
    """Sizes and speeds, see `sizes`; of a joint whose angles are too large the speed says nothing more."""
    found = sizes(log, joint_limits)
    told = {finding.joint for finding in found if finding.severity == "error"}
    return found + speeds(log, [column for column, joint in enumerate(log.joint_names) if joint not in told])


def sizes(log: MotorLog, joint_limits: np.ndarray | None = None) -> list[Finding]:
    """Angles beyond one turn, or over more than one; errors: beyond four turns, beyond 100 rad, and what is WILD.

    A joint whose limits are known may turn as far as they allow.

    Args:
        log: the log.
        joint_limits: (J, 2) lowest and highest angle [rad], infinite of a joint that turns on and on, NaN where they
            are not known; None if none is.
    """
    limits = (
        np.zeros((log.num_joints, 2))
        if joint_limits is None
        else np.nan_to_num(joint_limits, posinf=np.inf, neginf=-np.inf)
    )
    found = []
    for channel in ANGLES:
        for column in range(log.num_joints):
            found += _size(log, channel, column, limits[column])
    return found + _wild(log)


def _size(log: MotorLog, channel: str, column: int, limits: np.ndarray) -> list[Finding]:
    """What the largest angle of a joint says, and the way between its extremes; ``limits`` (2,), 0 if not known."""
    joint, angle = log.joint_names[column], getattr(log, channel)[:, column]
    lowest, highest = int(np.argmin(angle)), int(np.argmax(angle))
    row = lowest if -angle[lowest] > angle[highest] else highest
    size, reach = abs(float(angle[row])), float(np.abs(limits).max())
    described = f"{channel}/{joint} is {size:.4g} rad in row {row}"
    if size > (most := max(WILD_ANGLE, reach)):
        remedy = f"if it is one row, delete it from the file; if all are so large, {_DEGREES}"
        return [Finding("error", "units", size, most, f"{described}, beyond {most:.4g} rad", remedy, joint, row)]
    if size > (most := max(FEW_TURNS, reach)):
        remedy = f"{_DEGREES}; of a joint that does turn so far, give its robot, whose limits say so"
        message = f"{described}, beyond {most / (2.0 * np.pi):.3g} turns"
        return [Finding("error", "units", size, most, message, remedy, joint, row)]
    if size > (most := max(MAX_ANGLE, reach)):
        return [Finding("warning", "units", size, most, f"{described}, beyond one turn", _UNSURE, joint, row)]
    way = float(angle[highest]) - float(angle[lowest])
    if way > (most := max(MAX_ANGLE, float(limits[1] - limits[0]))):
        message, row = f"{channel}/{joint} goes over {way:.4g} rad, more than one turn", max(lowest, highest)
        return [Finding("warning", "units", way, most, message, _UNSURE, joint, row)]
    return []


def _wild(log: MotorLog) -> list[Finding]:
    found = []
    for channel, most in WILD.items():
        values = getattr(log, channel)
        if values is not None and np.abs(values).max() > most:
            row, column = np.unravel_index(np.argmax(np.abs(values) > most), values.shape)
            value, joint = float(values[row, column]), log.joint_names[column]
            message = f"{channel}/{joint} is {value:.4g} {JOINT_SERIES[channel]} in row {row}, beyond {most:g}"
            remedy = "if it is one row, delete it from the file; if all are so large, convert the column to SI units"
            found.append(Finding("error", "units", value, most, message, remedy, joint, int(row)))
    return found


def speeds(log: MotorLog, columns: Sequence[int]) -> list[Finding]:
    """Errors: which of these joints move faster than 100 rad/s, by angle or joint_vel, in more than a handful of rows.

    A speed of an angle counts where the next one is as high, the same way, so that readings that jump, and what is
    between segments, are none.
    """
    found, (rows, lengths) = [], _places(log)
    for column in columns:
        joint = log.joint_names[column]
        speed = _lasting(np.diff(log.joint_pos[rows, column]) / lengths)
        fast = speed > MAX_SPEED
        if (count := int(fast.sum())) > HANDFUL:
            remedy = f"{_DEGREES}; if the time has another unit, do so with time"
            found.append(_fast("joint_pos", joint, float(speed.max()), int(rows[np.argmax(fast)]), count, remedy))
        if log.joint_vel is None:
            continue
        speed = np.abs(log.joint_vel[:, column])
        fast = speed > MAX_SPEED
        if (count := int(fast.sum())) > max(HANDFUL, SPEED_SHARE * log.num_rows):
            remedy = f'convert it in the file, or say what its unit is {IN_MAP}: velocity = "deg/s" or "rpm"'
            found.append(_fast("joint_vel", joint, float(speed.max()), int(np.argmax(fast)), count, remedy))
    return found


def _fast(channel: str, joint: str, most: float, row: int, count: int, remedy: str) -> Finding:
    message = (
        f"{channel}/{joint} moves at up to {most:.4g} rad/s, and in {count} places faster than {MAX_SPEED:g} rad/s, "
        f"first in row {row}"
    )
    return Finding("error", "units", most, MAX_SPEED, message, remedy, joint, row)


def _places(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """Rows (S + 1,) that are SPEED_TIME or a row apart, and the time between them (S,) [s]."""
    period = log.period
    width = max(1, round(SPEED_TIME / period))
    rows = np.arange(0, log.num_rows, width)
    return rows, np.maximum(np.diff(log.time[rows]), width * period)


def _lasting(speeds: np.ndarray) -> np.ndarray:
    """(S - 1,) smaller sizes of two speeds (S,) after one another, 0 where they go opposite ways."""
    one, other = speeds[1:], speeds[:-1]
    return np.maximum(np.maximum(np.minimum(one, other), -np.maximum(one, other)), 0.0)


def angles(log: MotorLog) -> list[Finding]:
    """The range of every measured angle in degrees, of which people know better than of radians what it should be."""
    low, high = log.joint_pos.min(axis=0).tolist(), log.joint_pos.max(axis=0).tolist()
    turn = 360.0 / (2.0 * np.pi)
    told = [
        f"{joint} {turn * least:.4g}..{turn * most:.4g}"
        for joint, least, most in zip(log.joint_names, low, high, strict=True)
    ]
    widest = max(abs(value) for value in (*low, *high))
    message = f"measured angles in degrees: {', '.join(told)}"
    remedy = "where these are not the joints' angles, " + _DEGREES
    return [Finding("info", "angles", widest, None, message, remedy, row=0)]


def torques(log: MotorLog) -> list[Finding]:
    """The largest torque of every joint [N·m], which people know of their motors."""
    if log.joint_torque is None:
        return []
    most = np.abs(log.joint_torque).max(axis=0)
    told = ", ".join(f"{joint} {size:.3g}" for joint, size in zip(log.joint_names, most.tolist(), strict=True))
    unit = 'torque = "mN·m" or "kg·cm"'
    remedy = f"if such motors have others, convert them in the file, or say what their unit is {IN_MAP}: {unit}"
    return [Finding("info", "torques", float(most.max()), None, f"largest torques in N·m: {told}", remedy, row=0)]
