"""What a log says of its motors and their load, and whether its torque is the one that moved the load."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.stated import stated_in_words

WINDOW = 0.05
"""Torques are compared as means over so long a time, or the noise of accelerations hides everything [s]."""
SLOPE = (0.7, 1.4)
"""Torque of the load over joint_torque that passes [-]."""
MIN_CORRELATION = 0.7
_MIN_WINDOWS = 20


def load_given(log: MotorLog) -> list[Finding]:
    """Whether the log says what its motors moved, and how much it varies: largest over smallest inertia."""
    if log.load_inertia is None:
        message = "the log does not say what its motors moved"
        remedy = "`motorprior logs import` adds loads, with hung or fit_load: docs/your-motors.md"
        return [Finding("info", "load_given", 0.0, None, message, remedy, row=0)]
    least, most = float(log.load_inertia.min()), float(log.load_inertia.max())
    message = f"load inertia {least:.3g} to {most:.3g} kg·m²"
    if log.external_torque is not None:
        message += f", external torque {log.external_torque.min():.3g} to {log.external_torque.max():.3g} N·m"
    return [Finding("info", "load_given", most / least, None, message, row=0)]


def stated(log: MotorLog) -> list[Finding]:
    """The gains, registers and postures that the log states: whoever fits motors to it takes them as given."""
    if told := stated_in_words(log):
        return [Finding("info", "stated", 1.0, None, f"the log states {told}", row=0)]
    remedy = f"state what you know by options of `motorprior logs import`, for every kind of file, or {IN_MAP}"
    return [Finding("info", "stated", 0.0, None, "the log states no gain, register or posture", remedy, row=0)]


def torque_and_load(log: MotorLog) -> list[Finding]:
    """joint_torque against the torque that the known load needed, joint by joint.

        needed = load_inertia·d(joint_vel)/dt - external_torque

    both as means over WINDOW; the slope is that of the least squares through 0. Says nothing of a log without loads,
    torques or velocities.
    """
    if log.joint_torque is None or log.load_inertia is None or log.external_torque is None or log.joint_vel is None:
        return []
    pairs = [_means(part) for part in log.segments()]
    measured, needed = (np.concatenate(columns) for columns in zip(*pairs, strict=True))
    if len(measured) < _MIN_WINDOWS:
        return []
    found = []
    for column in excited_joints(log):
        finding = _finding(log.joint_names[column], measured[:, column], needed[:, column])
        found += [] if finding is None else [finding]
    return found


def _means(part: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """(windows, J) means of the measured and of the needed torque of one segment."""
    assert part.joint_torque is not None and part.joint_vel is not None
    assert part.load_inertia is not None and part.external_torque is not None
    steps = time_steps(part)[1]
    length = max(1, round(WINDOW / float(np.median(steps)))) if steps.size else 1
    count = (part.num_rows - 1) // length
    ends = length * np.arange(count + 1)
    change = np.diff(part.joint_vel[ends], axis=0) / np.diff(part.time[ends])[:, None]
    mean = lambda values: values[: count * length].reshape(count, length, part.num_joints).mean(axis=1)  # noqa: E731
    return mean(part.joint_torque), mean(part.load_inertia) * change - mean(part.external_torque)


def _finding(joint: str, measured: np.ndarray, needed: np.ndarray) -> Finding | None:
    size = float(np.sqrt(np.dot(measured, measured) * np.dot(needed, needed)))
    if size == 0.0:
        return None
    correlation, slope = (
        float(np.dot(measured, needed)) / size,
        float(np.dot(measured, needed) / np.dot(measured, measured)),
    )
    if correlation < MIN_CORRELATION:
        remedy = (
            "check the load, the clocks of both, and the sign of the torque; turn it in the file, or "
            f"{IN_MAP} by [joints.….joint_torque]"
        )
        message = f"joint_torque/{joint} is not the torque that moved its load: correlation {correlation:.2f}"
        return Finding("warning", "load", correlation, MIN_CORRELATION, message, remedy, joint, row=0)
    if not SLOPE[0] <= slope <= SLOPE[1]:
        remedy = (
            "check the load_inertia, the torque constant and the unit of the torque; convert it in the file, "
            f"or {IN_MAP} by torque"
        )
        message = f"the load of {joint} needed {slope:.2f} times its joint_torque"
        return Finding("warning", "load", slope, SLOPE[int(slope > 1.0)], message, remedy, joint, row=0)
    return None
