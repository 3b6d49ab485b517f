"""Checks of channels against each other: does the angle follow its command, and the velocity the angle?"""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.command_lag import MAX_LAG, MIN_CORRELATION, Following, following
from motorprior.logs.doctor.excited_stretch import MIN_SAMPLES, Stretch
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog

DEAD_BAND = 0.1
"""A lag that is no longer a way than this, at the speed of the command, may be dead band, friction and sag [rad]."""
SLOW = 0.5
"""Slow is what means over so long a time show [s]."""
SLOW_STD = 0.02
"""Least standard deviation of a command that is slow enough to judge by [rad]."""
MIN_MEANS = 8
PROPORTION = (0.6, 1.5)
PROPORTIONAL = 0.999
"""Correlation of slow command and angle from which on a load or a dead band is no reason."""
MOST_OFFSET = 1.2
"""[rad]"""
VELOCITY_WINDOW = 0.1
VELOCITY_SLOPE = (0.7, 1.4)
MOVING_STD = 1e-3
_VELOCITY_UNITS = {"deg/s": 180.0 / np.pi, "rpm": 30.0 / np.pi}
"""What one rad/s is in units that a column map knows."""
_ALIKE = 0.2


def tracking(parts: list[Stretch]) -> list[Finding]:
    """Lag [s] of an excited angle behind its command, whether it opposes it (`command_lag`), and how far it is off.

    All of the part in which the joint follows best: pushes, or a command of one frequency, may hide it in others. Where
    it follows in none, of that in which it opposes most.
    """
    every = [(following(part.command, part.angle, part.period), part) for part in parts]
    follow = [pair for pair in every if pair[0].correlation >= MIN_CORRELATION and not pair[0].opposes]
    if follow:
        seen, part = max(follow, key=lambda pair: (not pair[0].undecided, pair[0].correlation))
    else:
        seen, part = max(every, key=lambda pair: (pair[0].opposes, -pair[0].opposed_correlation))
    speed = float(np.percentile(np.abs(np.diff(part.command)), 95)) / part.period
    found = [_tracking_finding(part.joint, seen, speed, part.row)]
    if seen.correlation >= MIN_CORRELATION and not seen.opposes:
        found += _proportion(part)
    return found


def _tracking_finding(joint: str, seen: Following, speed: float, row: int) -> Finding:
    described = f"{joint} follows its command {1e3 * seen.lag:.3g} ms later, correlation {seen.correlation:.2f}"
    opposed = f"{1e3 * seen.opposed_lag:.3g} ms later, correlation {seen.opposed_correlation:.2f}"
    if seen.opposes:
        remedy = (
            f"turn the one that is the other way round in the file, or say so {IN_MAP}: sign = -1 in the table "
            "[joints.….joint_pos] or [joints.….position_target]"
        )
        message = f"{joint} moves against its command {opposed}"
        return Finding("error", "tracking", seen.opposed_correlation, -MIN_CORRELATION, message, remedy, joint, row)
    if seen.correlation < MIN_CORRELATION:
        remedy = "check power, the joint order and the clocks; or command more than the dead band of the servo"
        message = f"{described}, less than {MIN_CORRELATION}"
        return Finding("warning", "tracking", seen.correlation, MIN_CORRELATION, message, remedy, joint, row)
    if seen.undecided:
        remedy = "record more than one frequency, or a step: one sine alone cannot tell"
        message = f"{described}, or moves against it {opposed}"
        return Finding("warning", "tracking", seen.lag, seen.opposed_lag, message, remedy, joint, row)
    if seen.lead > 0.0:
        message = f"{joint} moves {1e3 * seen.lead:.3g} ms before its command, correlation {seen.correlation:.2f}"
        remedy = "command and measurement have different clocks, or are in different rows: put them on one clock"
        return Finding("warning", "tracking", -seen.lead, 0.0, message, remedy, joint, row)
    if seen.lag > MAX_LAG and seen.lag * speed > DEAD_BAND:
        remedy = "check the clocks of command and measurement"
        message = f"{described}, more than {1e3 * MAX_LAG:g} ms"
        return Finding("warning", "tracking", seen.lag, MAX_LAG, message, remedy, joint, row)
    if seen.lag > MAX_LAG:
        described += ": so slow a command shows dead band and friction as lag"
    return Finding("info", "tracking", seen.lag, MAX_LAG, described, joint=joint, row=row)


def _proportion(stretch: Stretch) -> list[Finding]:
    """How far the angle goes per command where both are slow, and how far from it it is in the middle.

    Of means over SLOW, so that neither lag nor resonance counts; a load bends a weak servo, and so the bounds are wide.
    """
    length = max(1, round(SLOW / stretch.period))
    count = len(stretch.angle) // length
    command, angle = (
        values[: count * length].reshape(count, length).mean(axis=1) for values in (stretch.command, stretch.angle)
    )
    found, joint = [], stretch.joint
    offset = float(np.median(stretch.angle - stretch.command))
    if abs(offset) > MOST_OFFSET:
        message = f"{joint} is {offset:+.2f} rad off its command, median, more than {MOST_OFFSET:g}"
        remedy = (
            "if no load bends it so far, command and angle have different zeros: correct one in the file, or "
            f"{IN_MAP} by zero"
        )
        found.append(Finding("warning", "offset", offset, MOST_OFFSET, message, remedy, joint, stretch.row))
    if count < MIN_MEANS or np.std(command) < SLOW_STD:
        return found
    slope = float(np.cov(command, angle)[0, 1] / np.var(command, ddof=1))
    alike = float(np.corrcoef(command, angle)[0, 1]) > PROPORTIONAL
    if alike and not PROPORTION[0] <= slope <= PROPORTION[1]:
        message = f"{joint} goes {slope:.2f} rad per rad of slow command, outside {PROPORTION[0]} to {PROPORTION[1]}"
        remedy = (
            "command and angle seem to have different units or ticks per turn: convert one in the file, or say so "
            f"{IN_MAP} by angle and ticks_per_turn"
        )
        bound = PROPORTION[int(slope > PROPORTION[1])]
        found.append(Finding("warning", "proportion", slope, bound, message, remedy, joint, stretch.row))
    return found


def velocity(log: MotorLog) -> list[Finding]:
    """Slope of ∫joint_vel dt against the change of joint_pos over windows of about 0.1 s; 1 if consistent.

    Integrating the velocity instead of differentiating the angle keeps encoder steps out of it.
    """
    if log.joint_vel is None:
        return []
    integrated, moved = _window_changes(log)
    found = []
    for column, joint in enumerate(log.joint_names):
        if len(moved) < MIN_SAMPLES or np.std(moved[:, column]) < MOVING_STD:
            continue
        one, other = integrated[:, column], moved[:, column]
        slope = float(other @ one / (other @ other))
        size = float(np.sqrt((one @ one) * (other @ other)))
        found.append(_velocity_finding(joint, slope, float(one @ other) / size if size else 0.0))
    return found


def _window_changes(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """∫joint_vel dt (trapezoids) and change of joint_pos, both (windows, J) [rad]."""
    assert log.joint_vel is not None
    width = max(1, round(VELOCITY_WINDOW / log.period))
    integrated, moved = [], []
    for part in log.segment_slices():
        speed, step = log.joint_vel[part], np.diff(log.time[part])[:, None]
        angle = np.concatenate([np.zeros((1, log.num_joints)), np.cumsum(step * (speed[1:] + speed[:-1]) / 2, 0)])
        integrated.append(angle[width:] - angle[:-width])
        moved.append(log.joint_pos[part][width:] - log.joint_pos[part][:-width])
    return np.concatenate(integrated), np.concatenate(moved)


def _velocity_finding(joint: str, slope: float, correlation: float) -> Finding:
    low, high = VELOCITY_SLOPE
    described = f"{joint}: integrated joint_vel is {slope:.3g} times the change of joint_pos"
    if low <= slope <= high:
        return Finding("info", "velocity", slope, None, described, joint=joint, row=0)
    bound = low if slope < low else high
    severity = "error" if correlation < -MIN_CORRELATION else "warning"
    remedy = _velocity_remedy(slope, correlation)
    message = f"{described}, outside {low}..{high}"
    return Finding(severity, "velocity", slope, bound, message, remedy, joint, row=0)


def _velocity_remedy(slope: float, correlation: float) -> str:
    if abs(correlation) < MIN_CORRELATION:
        return (
            f"the two have little to do with each other (correlation {correlation:.2f}): check the order of the "
            f"joints, or leave joint_vel out of the file or {IN_MAP}"
        )
    if slope < 0.0:
        return f"turn it in the file, or {IN_MAP}: sign = -1 in the table [joints.….joint_vel]"
    for unit, per_si in _VELOCITY_UNITS.items():
        if abs(slope / per_si - 1.0) < _ALIKE:
            return f'these seem to be {unit}: convert them in the file, or say velocity = "{unit}" {IN_MAP}'
    return (
        "check that joint_vel is of the output side of the gear, its times, and its unit; convert it in the file, or "
        f"{IN_MAP} by velocity"
    )
