"""Checks of channels against each other: does the angle follow its command, and the velocity the angle?"""

from __future__ import annotations

import numpy as np

from motorprior.logs.findings import Finding
from motorprior.logs.joint_checks import excited_joints
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.resampling import repeated_rows, resample

MAX_LAG = 0.3
SEARCHED_LAG = 0.5
MIN_CORRELATION = 0.5
VELOCITY_WINDOW = 0.1
VELOCITY_SLOPE = (0.7, 1.4)
MOVING_STD = 1e-3
MAX_SAMPLES = 20_000
_MIN_ROWS = 20


def tracking(log: MotorLog) -> list[Finding]:
    """Lag [s] at which each excited angle correlates best with its command, in the longest segment.

    lag = argmax over 0..0.5 s of corr(joint_pos(t), position_target(t - lag)).
    """
    segment = max(log.segments(), key=lambda part: part.duration)
    steps = np.diff(segment.rows(~repeated_rows(segment)).time)
    period = max(float(np.median(steps)) if steps.size else 0.0, segment.duration / MAX_SAMPLES)
    if period <= 0.0 or segment.duration < _MIN_ROWS * period:
        return []
    uniform = resample(segment, period)
    max_shift = min(int(SEARCHED_LAG / period), uniform.num_rows // 2)
    found = []
    for column in excited_joints(uniform):
        correlations = _lagged_correlations(uniform.position_target[:, column], uniform.joint_pos[:, column], max_shift)
        best = int(np.argmax(np.abs(correlations)))
        found.append(_tracking_finding(uniform.joint_names[column], float(correlations[best]), best * period))
    return found


def _lagged_correlations(command: np.ndarray, angle: np.ndarray, max_shift: int) -> np.ndarray:
    shifts = range(max_shift + 1)
    return np.array([_correlation(command[: len(command) - k], angle[k:]) for k in shifts])


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt(np.dot(a, a) * np.dot(b, b)))
    return float(np.dot(a, b)) / scale if scale > 0.0 else 0.0


def _tracking_finding(joint: str, correlation: float, lag: float) -> Finding:
    described = f"{joint} follows its command {1e3 * lag:.3g} ms later, correlation {correlation:.2f}"
    if correlation < -MIN_CORRELATION and lag < MAX_LAG:
        remedy = "flip the sign of one of them: position error is position_target - joint_pos"
        message = f"{joint} moves against its command, correlation {correlation:.2f}"
        return Finding("error", "tracking", correlation, -MIN_CORRELATION, message, remedy, joint)
    if abs(correlation) < MIN_CORRELATION:
        remedy = "check power, the joint order and the clocks of command and measurement"
        message = f"{described}, less than {MIN_CORRELATION}"
        return Finding("warning", "tracking", correlation, MIN_CORRELATION, message, remedy, joint)
    if lag > MAX_LAG:
        remedy = "check the clocks of command and measurement"
        message = f"{described}, more than {1e3 * MAX_LAG:g} ms"
        return Finding("warning", "tracking", lag, MAX_LAG, message, remedy, joint)
    return Finding("info", "tracking", lag, MAX_LAG, described, joint=joint)


def velocity(log: MotorLog) -> list[Finding]:
    """Slope of ∫joint_vel dt against the change of joint_pos over windows of about 0.1 s; 1 if consistent.

    Integrating the velocity instead of differentiating the angle keeps encoder steps out of it.
    """
    if log.joint_vel is None:
        return []
    integrated, moved = _window_changes(log)
    found = []
    for column, joint in enumerate(log.joint_names):
        if len(moved) < _MIN_ROWS or np.std(moved[:, column]) < MOVING_STD:
            continue
        slope = float(moved[:, column] @ integrated[:, column] / (moved[:, column] @ moved[:, column]))
        found.append(_velocity_finding(joint, slope))
    return found


def _window_changes(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """∫joint_vel dt (trapezoids) and change of joint_pos, both (windows, J) [rad]."""
    assert log.joint_vel is not None
    _, steps = time_steps(log)
    width = max(1, round(VELOCITY_WINDOW / float(np.median(steps))))
    integrated, moved = [], []
    for part in log.segment_slices():
        speed, step = log.joint_vel[part], np.diff(log.time[part])[:, None]
        angle = np.concatenate([np.zeros((1, log.num_joints)), np.cumsum(step * (speed[1:] + speed[:-1]) / 2, 0)])
        integrated.append(angle[width:] - angle[:-width])
        moved.append(log.joint_pos[part][width:] - log.joint_pos[part][:-width])
    return np.concatenate(integrated), np.concatenate(moved)


def _velocity_finding(joint: str, slope: float) -> Finding:
    low, high = VELOCITY_SLOPE
    described = f"{joint}: integrated joint_vel is {slope:.3g} times the change of joint_pos"
    if low <= slope <= high:
        return Finding("info", "velocity", slope, None, described, joint=joint)
    bound = low if slope < low else high
    severity = "error" if slope < 0.0 else "warning"
    remedy = "check sign, unit (rad/s, at the output side of the gear) and time stamps of joint_vel"
    message = f"{described}, outside {low}..{high}"
    return Finding(severity, "velocity", slope, bound, message, remedy, joint)
