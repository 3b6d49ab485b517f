"""Checks of the response: angle against command, velocity against angle, limits.

A window is one joint on a uniform grid.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from motorprior.logs.doctor.excitation import MIN_ROWS
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.readings import MAX_LAG, encoder_step
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import excited_joints
from motorprior.signals import runs_of_true

MIN_CORRELATION = 0.5
SLOPES = (0.6, 1.5)  # bounds of slow angle per command; otherwise the units differ
# correlation above which units explain a slope that is too small, too large: loads and dead bands lower it
STRAIGHT = (0.9975, 0.95)
VELOCITY_SLOPES = (0.7, 1.4)
TRAVEL = 0.1  # share of its range by which the command continues beyond a limit


def correlation_peaks(window: MotorLog) -> tuple[np.ndarray, int, int, int]:
    """Correlation r[k] of the angle with the command k rows before, over the same rows of the angle for all k.

    Returns:
        r for k = -lead, …, lag; lead; and k >= 0 of the first positive and of the first negative peak.
    """
    command, angle = window.position_target[:, 0], window.joint_pos[:, 0]
    lag = min(int(0.5 / window.period), len(angle) // 2)  # 0.5 s later
    lead = min(max(1, int(0.25 / window.period)), len(angle) // 4)  # to 0.25 s earlier
    later = angle[lag : len(angle) - lead] - angle[lag : len(angle) - lead].mean()
    r = np.zeros(lead + lag + 1)
    for index in range(len(r)):
        part = command[lag + lead - index :][: len(later)]
        part = part - part.mean()
        r[index] = part @ later / max(np.sqrt((part @ part) * (later @ later)), 1e-300)
    return r, lead, _first_peak(r[lead - 1 :]), _first_peak(-r[lead - 1 :])


def _first_peak(r: np.ndarray) -> int:
    """Index of the first peak of r[1:] above 95 % of the highest; equal peaks of a sine are one period apart.

    Ripple is no peak: r must fall by 0.1 between a peak and the highest.
    """
    best = 1 + int(np.argmax(r[1:]))
    for here in range(1, best):
        high = r[here] >= max(r[here - 1], r[here + 1], 0.95 * r[best])
        if high and r[here:best].min() < r[here] - 0.1:
            return here - 1
    return best - 1


def lag_rows(window: MotorLog) -> int | None:
    """Lag of the angle behind its command in rows, 0.25 s at most; None if it does not follow."""
    r, lead, late, opposed = correlation_peaks(window)
    follows = r[lead + late] >= max(MIN_CORRELATION, -r[lead + opposed])
    return min(late, int(MAX_LAG / window.period)) if follows else None


def tracking(window: MotorLog) -> Iterator[Finding]:
    """Sign, joint order and lag of the angle against the command, by the first peak of their correlation.

    An angle opposes its command if, within a servo's lag, the correlation falls further below 0 than it rises above.
    """
    (r, lead, late, opposed), joint, period = correlation_peaks(window), window.joint_names[0], window.period
    seconds, follows, opposes = late * period, float(r[lead + late]), float(r[lead + opposed])
    described = f"{joint} follows its command {1e3 * seconds:.3g} ms later, correlation {follows:.2f}"
    against = f"moves against its command {1e3 * opposed * period:.3g} ms later, correlation {opposes:.2f}"
    can_oppose = opposes < -MIN_CORRELATION and opposed * period < MAX_LAG
    ahead = int(np.argmin(np.append(np.diff(r[lead::-1]) > 0.0, False)))  # while the correlation rises
    speed = float(np.percentile(np.abs(np.diff(window.position_target[:, 0])), 95)) / period
    severity, value, message, remedy = "warning", seconds, described, ""
    if can_oppose and -opposes - (follows if seconds < MAX_LAG else 0.0) > 0.1:
        severity, value, message = "error", opposes, f"{joint} {against}"
        remedy = f"reverse one of them in the file, or {IN_MAP}: sign = -1 in [joints.….joint_pos] or "
        remedy += "[joints.….position_target]"
    elif follows < MIN_CORRELATION:
        value, message = follows, f"{described}, below {MIN_CORRELATION}"
        remedy = "check power, joint order and clocks; or command more than the dead band of the servo"
    elif can_oppose and opposed < late and seconds < MAX_LAG:
        message = f"{described}, or {against}"
        remedy = "record more than one frequency, or a step: the lag of one sine is ambiguous"
    elif ahead * period >= 0.015 and 1.0 - r[lead - ahead] <= 0.2 * (1.0 - r[lead]):
        value, correlation = -ahead * period, r[lead - ahead]
        message = f"{joint} moves {1e3 * ahead * period:.3g} ms before its command, correlation {correlation:.2f}"
        remedy = "command and measurement have different clocks, or are in different rows: put them on one clock"
    elif seconds > MAX_LAG and seconds * speed > 0.1:  # [rad]; less may be dead band and friction
        message, remedy = f"{described}, above {1e3 * MAX_LAG:g} ms", "check the clocks of command and measurement"
    else:
        severity = "info"
    yield Finding(severity, "tracking", value, message, remedy, joint)


def proportion(window: MotorLog) -> Iterator[Finding]:
    """Offset of the angle from its command, and slope of slow motion, by means over 0.5 s without fast commands."""
    joint, late = window.joint_names[0], lag_rows(window)
    if late is None:
        return
    offset = float(np.median(window.joint_pos - window.position_target))
    if abs(offset) > 1.2:  # loads deflect servos less
        message = f"{joint} is {offset:+.2f} rad off its command (median), more than 1.2"
        remedy = f"if no load deflects it so far, correct the zero of command or angle in the file, or {IN_MAP}"
        yield Finding("warning", "offset", offset, message, remedy, joint)
    length = max(1, round(0.5 / window.period))
    count = (window.num_rows - late) // length
    command = window.position_target[: count * length].reshape(count, length)
    angle = window.joint_pos[late : late + count * length].reshape(count, length)
    slow = command.std(axis=1) <= 0.5 * np.std(window.position_target)
    command, angle = command[slow].mean(axis=1), angle[slow].mean(axis=1)
    if len(command) < 8 or np.std(command) < 0.02 or np.std(angle) == 0.0:
        return
    (variance, covariance), (_, other) = np.cov(command, angle)
    slope, correlation = float(covariance / variance), float(covariance / np.sqrt(variance * other))
    if not SLOPES[0] <= slope <= SLOPES[1] and correlation > STRAIGHT[int(slope > 1.0)]:
        message = f"{joint} moves {slope:.2f} rad per rad of slow command, outside {SLOPES[0]} to {SLOPES[1]}"
        remedy = f"command and angle have different units or ticks per turn: convert one in the file, or {IN_MAP}"
        yield Finding("warning", "proportion", slope, message, remedy, joint)


def copied(log: MotorLog) -> Iterator[Finding]:
    """Angles that equal their command in more than 90 % of the rows in which it changes (error)."""
    for column in excited_joints(log):
        command, joint = log.position_target[:, column], log.joint_names[column]
        rows = 1 + np.flatnonzero(np.diff(command))
        same = np.abs(log.joint_pos[rows, column] - command[rows]) <= 1e-6
        if len(rows) < 5 or same.mean() <= 0.9:
            continue
        message = f"joint_pos/{joint} equals its command in {100 * same.mean():.4g} % of the rows in which it changes"
        remedy = f"the command is recorded twice: check the columns of the file, and their names {IN_MAP}"
        row = int(rows[np.argmax(same)])
        yield Finding("error", "copied", float(same.mean()), message, remedy, joint, row)


def velocity(log: MotorLog) -> Iterator[Finding]:
    """Slope of the integral of joint_vel against the change of joint_pos over 0.1 s, insensitive to encoder steps."""
    if log.joint_vel is None:
        return
    width = max(1, round(0.1 / log.period))
    integrated, moved = [], []
    for part in log.segments():
        assert part.joint_vel is not None
        steps = np.diff(part.time)[:, None] * 0.5 * (part.joint_vel[1:] + part.joint_vel[:-1])
        integral = np.concatenate([np.zeros((1, log.num_joints)), np.cumsum(steps, axis=0)])
        integrated.append(integral[width:] - integral[:-width])
        moved.append(part.joint_pos[width:] - part.joint_pos[:-width])
    for joint, one, other in zip(log.joint_names, np.concatenate(integrated).T, np.concatenate(moved).T, strict=True):
        if len(other) < MIN_ROWS or np.std(other) < 1e-3:
            continue
        slope = float(other @ one / (other @ other))
        correlation = float(other @ one / max(np.sqrt((one @ one) * (other @ other)), 1e-300))
        message = f"{joint}: integrated joint_vel is {slope:.3g} times the change of joint_pos"
        if VELOCITY_SLOPES[0] <= slope <= VELOCITY_SLOPES[1]:
            yield Finding("info", "velocity", slope, message, joint=joint, row=0)
            continue
        remedy = f"check its joint order, gear, sign and unit; correct it in the file, or {IN_MAP}: sign = -1 in "
        remedy += '[joints.….joint_vel], velocity = "deg/s" or "rpm"; or leave it out'
        message += f", outside {VELOCITY_SLOPES[0]} to {VELOCITY_SLOPES[1]} (correlation {correlation:.2f})"
        wrong = abs(correlation) > MIN_CORRELATION and (slope < 0.0 or slope > 5.0)  # sign, or deg/s, rpm
        severity = "error" if wrong else "warning"
        yield Finding(severity, "velocity", slope, message, remedy, joint, 0)


def saturation(window: MotorLog) -> Iterator[Finding]:
    """An angle that rests at its extreme for 0.1 s while the command continues beyond it by 10 % of its range.

    Friction and dead band hold a joint after a reversal, too. So either the command is 2.5 times as far away as the RMS
    of other errors; or the command of the lag before rises by 0.03 rad after the joint stopped.
    """
    joint, late = window.joint_names[0], lag_rows(window)
    if late is not None:
        late = min(late, int(0.1 / window.period))  # dead band and friction of slow motion cause longer lags
    min_rows = max(5, round(0.1 / window.period) + 1)  # reversals are shorter
    for sign in (1.0, -1.0):
        command, angle = sign * window.position_target[:, 0], sign * window.joint_pos[:, 0]
        at_top = runs_of_true(angle >= angle.max() - encoder_step(angle)).tolist()
        runs = [slice(*run) for run in at_top if run[0] and run[1] - run[0] >= min_rows]
        if runs := [run for run in runs if _at_end_stop(command, angle, run, late)]:
            time = window.period * sum(run.stop - run.start - 1 for run in runs)
            message = f"joint_pos/{joint} stays at its extreme {sign * angle.max():.4g} rad for {time:.2f} s in total "
            remedy = "keep it if the limit is to be identified; otherwise command less, or delete these rows"
            message += "while its command continues"
            yield Finding("warning", "saturation", time, message, remedy, joint, runs[0].start)


def _at_end_stop(command: np.ndarray, angle: np.ndarray, run: slice, late: int | None) -> bool:
    """Whether the command continues beyond the highest angle, reached in ``run``; ``late`` is the lag in rows."""
    top, travel, here = angle.max(), TRAVEL * np.ptp(command), command[run]
    if here.max() - max(here.min(), top) <= travel:
        return False
    error = (command - angle)[(angle < top - 1e-6) & (angle > angle.min() + 1e-6)]
    if not error.size or here.max() - top > 2.5 * np.sqrt(np.mean(error**2)):
        return True
    acting = command[max(0, run.start - (late or 0)) : max(1, run.stop - (late or 0))]
    return late is not None and bool(acting.max() - max(acting[0], top) > max(travel, 0.03))
