"""Checks of channels against each other: does the angle follow its command, and the velocity the angle?"""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.command_lag import MAX_LAG, MIN_CORRELATION, Following, following
from motorprior.logs.doctor.excited_stretch import MIN_SAMPLES, Stretch
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.doctor.sensor_checks import SMALLEST_STEP
from motorprior.logs.motor_log import MotorLog

DEAD_BAND = 0.1
"""A lag that is no longer a way than this, at the speed of the command, may be dead band, friction and sag [rad]."""
SLOW = 0.5
"""Slow is what means over so long a time show [s]."""
SLOWLY = 0.5
"""A slow command varies in that time by this share of its whole standard deviation at most."""
SLOW_STD = 0.02
"""Least standard deviation of a command that is slow enough to judge by [rad]."""
MIN_MEANS = 8
PROPORTION = (0.6, 1.5)
PROPORTIONAL = (0.9975, 0.95)
"""Correlation of slow command and angle above which units explain a slope below PROPORTION, and one above it. A load
and a dead band make servos go less far, too, but friction then shows; little makes them go further."""
COPIED = 0.9
"""An angle that equals its command in more than this share of the rows in which that changes is a copy of it."""
MIN_CHANGES = 5
MOST_OFFSET = 1.2
"""[rad]"""
VELOCITY_WINDOW = 0.1
VELOCITY_SLOPE = (0.7, 1.4)
MOVING_STD = 1e-3
_VELOCITY_UNITS = {"deg/s": 180.0 / np.pi, "rpm": 30.0 / np.pi}
"""What one rad/s is in units that a column map knows."""
_ALIKE = 0.2


def best_followed(parts: list[Stretch]) -> tuple[Following, Stretch]:
    """The part in which a joint follows its command best, and how: pushes, or one frequency, may hide it in others.

    Where it follows in none, that in which it opposes most.
    """
    every = [(following(part.command, part.angle, part.period), part) for part in parts]
    follow = [pair for pair in every if pair[0].follows]
    if follow:
        return max(follow, key=lambda pair: (not pair[0].undecided, pair[0].correlation))
    return max(every, key=lambda pair: (pair[0].opposes, -pair[0].opposed_correlation))


def tracking(seen: Following, part: Stretch) -> list[Finding]:
    """Lag [s] of an excited angle behind its command, whether it opposes it (`command_lag`), and how far it is off."""
    speed = float(np.percentile(np.abs(np.diff(part.command)), 95)) / part.period
    found = [_tracking_finding(part.joint, seen, speed, part.row)]
    if seen.follows:
        found += _offset(part)
        found += _proportion(part, seen.servo_lag)
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


def _offset(stretch: Stretch) -> list[Finding]:
    """How far the angle is from its command in the middle."""
    offset, joint = float(np.median(stretch.angle - stretch.command)), stretch.joint
    if abs(offset) <= MOST_OFFSET:
        return []
    message = f"{joint} is {offset:+.2f} rad off its command, median, more than {MOST_OFFSET:g}"
    remedy = (
        "if no load bends it so far, command and angle have different zeros: correct one in the file, or "
        f"{IN_MAP} by zero"
    )
    return [Finding("warning", "offset", offset, MOST_OFFSET, message, remedy, joint, stretch.row)]


def _proportion(stretch: Stretch, lag: float) -> list[Finding]:
    """How far the angle goes per command where both are slow; a load bends a weak servo, and so the bounds are wide."""
    joint, (command, angle) = stretch.joint, _slow_means(stretch, lag)
    if len(command) < MIN_MEANS or np.std(command) < SLOW_STD or np.std(angle) == 0.0:
        return []
    slope = float(np.cov(command, angle)[0, 1] / np.var(command, ddof=1))
    more = int(slope > 1.0)
    if PROPORTION[0] <= slope <= PROPORTION[1] or np.corrcoef(command, angle)[0, 1] <= PROPORTIONAL[more]:
        return []
    message = f"{joint} goes {slope:.2f} rad per rad of slow command, outside {PROPORTION[0]} to {PROPORTION[1]}"
    remedy = (
        "command and angle seem to have different units or ticks per turn: convert one in the file, or say so "
        f"{IN_MAP} by angle and ticks_per_turn"
    )
    return [Finding("warning", "proportion", slope, PROPORTION[more], message, remedy, joint, stretch.row)]


def _slow_means(stretch: Stretch, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Means (M,) [rad] over SLOW of the command, and of the angle ``lag`` [s] later, where the command is slow.

    Neither lag nor resonance shows in them; the fast part of a chirp would only add noise.
    """
    length, late = max(1, round(SLOW / stretch.period)), round(lag / stretch.period)
    count = (len(stretch.angle) - late) // length
    command, angle = (
        values[: count * length].reshape(count, length) for values in (stretch.command, stretch.angle[late:])
    )
    slow = command.std(axis=1) <= SLOWLY * np.std(stretch.command)
    return command[slow].mean(axis=1), angle[slow].mean(axis=1)


def copied(log: MotorLog) -> list[Finding]:
    """Excited angles that equal their command in nearly every row in which it changes: no servo arrives at once."""
    found = []
    for column in excited_joints(log):
        command, joint = log.position_target[:, column], log.joint_names[column]
        parts = log.segment_slices()
        rows = np.concatenate([part.start + 1 + np.flatnonzero(np.diff(command[part])) for part in parts])
        same = np.abs(log.joint_pos[rows, column] - command[rows]) <= SMALLEST_STEP
        if len(rows) < MIN_CHANGES or (share := float(same.mean())) <= COPIED:
            continue
        message = f"joint_pos/{joint} equals its command in {100 * share:.4g} % of the rows in which that changes"
        remedy = (
            "the command seems to be recorded twice: check what the file's columns are, and how they are named "
            f"{IN_MAP}; or record what the encoder reads"
        )
        row = int(rows[np.argmax(same)])
        found.append(Finding("error", "copied", share, COPIED, message, remedy, joint, row))
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
