"""Checks of motion: excitation, dead channels, angle against command, velocity against angle, end stops.

A window is one joint on a uniform grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.readings import MAX_LAG, velocity_spikes
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import (
    EXCITED_STD,
    excited_joints,
    gap_rows,
    repeated_rows,
    resample,
)
from motorprior.signals import encoder_step, runs_of_true

MIN_CORRELATION = 0.5
VELOCITY_SLOPES = (0.7, 1.4)
TRAVEL = 0.1  # share of its range by which the command continues beyond an end stop
MAX_OFFSET = 1.2  # maximum offset of an angle from its command [rad]; loads deflect servos less
CERTAIN_CORRELATION = 0.8  # correlation above which sign and order of a joint are certain
RATIOS = (0.1, 3.0)  # plausible motion / command; others mean a failed motion or another unit
MIN_REVERSALS = 4
# size of a window
MIN_ROWS = 20
MAX_ROWS = 20_000


def excited_window(log: MotorLog, column: int) -> tuple[slice, MotorLog] | None:
    """The window without gaps in which the command of a joint travels farthest, of 20 000 rows at most.

    Returns its rows, and that joint alone on a uniform grid with the period of new readings; None
    if the command moves in no window of 20 new readings.
    """
    best = 0.0
    found = None
    repeated = repeated_rows(log)
    command = log.position_target[:, column]
    starts = {part.start for part in log.segment_slices()} | set(gap_rows(log).tolist())
    for part in np.split(np.arange(log.num_rows), sorted(starts - {0})):
        for rows in np.split(part, range(MAX_ROWS, len(part), MAX_ROWS)):
            travel = float(np.abs(np.diff(command[rows])).sum())
            moves = np.std(command[rows]) > EXCITED_STD
            if moves and travel > best and np.sum(~repeated[rows]) > MIN_ROWS:
                best = travel
                found = slice(int(rows[0]), int(rows[-1]) + 1)
    if found is None:
        return None
    return found, resample(
        log.joint(column).rows(found), log.rows(found).rows(~repeated[found]).period
    )


def excitation(log: MotorLog) -> Iterator[Finding]:
    """Joints that are not commanded, move far less or more than commanded, or reverse rarely."""
    excited = excited_joints(log)
    if not excited.size:
        yield Finding(
            "error", "excitation", 0.0, "no joint is excited", "record commands that move"
        )
    for column, joint in enumerate(log.joint_names):
        command = log.position_target[:, column]
        angle = log.joint_pos[:, column]
        std = float(np.std(command))
        if column not in excited:
            message = (
                f"{joint} is not excited: standard deviation of its command {1e3 * std:.3f} mrad"
            )
            yield Finding("info", "excitation", std, message, joint=joint)
            continue
        if not RATIOS[0] <= (ratio := float(np.std(angle)) / std) <= RATIOS[1]:
            message = f"{joint} moves {ratio:.3g} times its command, outside {RATIOS[0]:g} to {RATIOS[1]:g}"
            remedy = f'check power, homing, joint order, and units {IN_MAP}: angle = "deg" in [joints.….joint_pos]'
            yield Finding("warning", "excitation", ratio, message, remedy, joint)
        if (count := sum(reversals(angle[part]) for part in log.segment_slices())) < MIN_REVERSALS:
            message = f"{joint}: {count} reversals, fewer than {MIN_REVERSALS}: friction and backlash need reversals"
            yield Finding(
                "warning", "reversals", count, message, "record motions back and forth", joint
            )


def reversals(angle: np.ndarray) -> int:
    """Number of reversals of an angle (T,) that exceed 5 % of its range."""
    count = -1
    direction = 0.0
    extreme = float(angle[0])
    threshold = 0.05 * float(np.ptp(angle))
    for value in angle[:: max(1, len(angle) // 200_000)].tolist():
        if direction and direction * (value - extreme) >= 0.0:
            extreme = value
        elif abs(value - extreme) > threshold:
            count = count + 1
            direction = value - extreme
            extreme = value
    return max(count, 0)


def frozen_angle(log: MotorLog) -> Iterator[Finding]:
    """Angles that rest for 0.5 s, away from end stops, while the command moves by half of its range and 0.1 rad.

    The last 0.25 s do not count, as a servo responds late.
    """
    for column in excited_joints(log):
        joint = log.joint_names[column]
        command = log.position_target[:, column]
        angle = log.joint_pos[:, column]
        still = np.diff(angle, prepend=np.nan) == 0.0
        still[[part.start for part in log.segment_slices()]] = False
        for after, end in runs_of_true(still).tolist():
            row = after - 1
            seconds = float(log.time[end - 1] - log.time[after - 1])
            moved = np.ptp(command[row : max(row + 1, end - round(MAX_LAG / log.period))])
            at_stop = angle[row] in (angle.min(), angle.max()) and np.ptp(angle) > 0.0
            if seconds >= 0.5 and moved > max(0.1, 0.5 * np.ptp(command)) and not at_stop:
                message = f"joint_pos/{joint} does not change for {seconds:.2f} s from row {row} while its command "
                remedy = "check sensor, power and bus; record again, or delete these rows"
                yield Finding(
                    "warning",
                    "dead",
                    seconds,
                    f"{message}moves by {moved:.2g} rad",
                    remedy,
                    joint,
                    row,
                )
                break


COMPARE = "compare sign and order of the joints, and the clocks of command and angle"
OTHER_SIGN = (
    f"reverse one {IN_MAP}: sign = -1 in [joints.….joint_pos] or [joints.….position_target]"
)
OTHER_ORDER = (
    f"commands and angles have different orders of joints: correct the column names {IN_MAP}"
)


def correlation_peaks(window: MotorLog) -> tuple[np.ndarray, int, int, int]:
    """Correlation r of the angle with the command k rows before, over the same rows of the angle.

    Returns r for k = -zero_lag, …, lag; zero_lag; k >= 0 of the first positive and of the first
    negative peak.
    """
    command = window.position_target[:, 0]
    angle = window.joint_pos[:, 0]
    lag = min(int(0.5 / window.period), len(angle) // 2)  # 0.5 s later
    zero_lag = min(max(1, int(0.25 / window.period)), len(angle) // 4)  # to 0.25 s earlier
    later = angle[lag : len(angle) - zero_lag] - angle[lag : len(angle) - zero_lag].mean()
    r = np.zeros(zero_lag + lag + 1)
    for index in range(len(r)):
        part = command[lag + zero_lag - index :][: len(later)]
        part = part - part.mean()
        r[index] = part @ later / max(np.sqrt((part @ part) * (later @ later)), 1e-300)
    return r, zero_lag, _first_peak(r[zero_lag - 1 :]), _first_peak(-r[zero_lag - 1 :])


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


def tracking(window: MotorLog) -> Iterator[Finding]:
    """Sign, joint order, lag and offset of the angle against the command, by the first peak of their correlation.

    An angle opposes its command if the negative peak within a servo's lag is larger than the
    positive one.
    """
    (r, zero_lag, late, opposed), joint, period = (
        correlation_peaks(window),
        window.joint_names[0],
        window.period,
    )
    seconds = late * period
    follows = float(r[zero_lag + late])
    opposes = float(r[zero_lag + opposed])
    described = (
        f"{joint} follows its command {1e3 * seconds:.3g} ms later, correlation {follows:.2f}"
    )
    against = f"moves against its command {1e3 * opposed * period:.3g} ms later, correlation {opposes:.2f}"
    can_oppose = opposes < -MIN_CORRELATION and opposed * period < MAX_LAG
    # while the correlation rises
    ahead = int(np.argmin(np.append(np.diff(r[zero_lag::-1]) > 0.0, False)))
    speed = float(np.percentile(np.abs(np.diff(window.position_target[:, 0])), 95)) / period
    severity = "warning"
    value = seconds
    message = described
    remedy = ""
    if can_oppose and -opposes - (follows if seconds < MAX_LAG else 0.0) > 0.1:
        severity = "error"
        value = opposes
        message = f"{joint} {against}"
        remedy = OTHER_SIGN if -opposes > CERTAIN_CORRELATION else COMPARE
    elif follows < MIN_CORRELATION:
        value = follows
        message = f"{described}, below {MIN_CORRELATION}"
        remedy = (
            "check power, joint order and clocks; or command more than the dead band of the servo"
        )
    elif can_oppose and opposed < late and seconds < MAX_LAG:
        message = f"{described}, or {against}"
        remedy = "record more than one frequency, or a step: the lag of one sine is ambiguous"
    elif ahead * period >= 0.015 and 1.0 - r[zero_lag - ahead] <= 0.2 * (1.0 - r[zero_lag]):
        value = -ahead * period
        message = f"{joint} moves {1e3 * ahead * period:.3g} ms before its command"
        remedy = "command and measurement have different clocks, or are in different rows: put them on one clock"
    elif seconds > MAX_LAG and seconds * speed > 0.1:  # [rad]; less may be dead band and friction
        message = f"{described}, above {1e3 * MAX_LAG:g} ms"
        remedy = "check the clocks of command and measurement"
    else:
        severity = "info"
    yield Finding(severity, "tracking", value, message, remedy, joint)
    offset = float(np.median(window.joint_pos - window.position_target))
    if abs(offset) > MAX_OFFSET and follows >= MIN_CORRELATION:
        message = f"{joint} is {offset:+.2f} rad off its command (median), more than {MAX_OFFSET}"
        remedy = f"if no load deflects it so far, correct the zero of command or angle in the file, or {IN_MAP}"
        yield Finding("warning", "offset", offset, message, remedy, joint)


def followed_joint(log: MotorLog, rows: slice, window: MotorLog, others: Sequence[int]) -> str:
    """The joint of ``others`` whose command the angle of a window clearly follows best within a servo's lag; or ""."""
    grid = resample(log.rows(rows), window.period)
    best = CERTAIN_CORRELATION
    name = ""
    for other in others:
        r, zero_lag, late, _ = correlation_peaks(
            replace(window, position_target=grid.position_target[:, [other]])
        )
        if late * window.period < MAX_LAG and r[zero_lag + late] > best:
            best = float(r[zero_lag + late])
            name = log.joint_names[other]
    return "" if name == window.joint_names[0] else name


def saturation(window: MotorLog) -> Iterator[Finding]:
    """An angle that rests at its extreme for 0.1 s while the command, delayed by the lag, continues beyond it.

    The command continues by 10 % of its range and 0.03 rad after the joint stopped. Friction and
    dead bands stop a joint only after a reversal.
    """
    joint, (r, zero_lag, late, _) = window.joint_names[0], correlation_peaks(window)
    late = min(late, int(0.1 / window.period)) if r[zero_lag + late] >= MIN_CORRELATION else 0
    min_rows = max(5, round(0.1 / window.period) + 1)  # reversals are shorter
    for sign in (1.0, -1.0):
        command = sign * window.position_target[:, 0]
        angle = sign * window.joint_pos[:, 0]
        top = angle.max()
        beyond = max(TRAVEL * np.ptp(command), 0.03)
        found = []
        for first, after in runs_of_true(angle >= top - encoder_step(angle)).tolist():
            acting = command[max(0, first - late) : max(1, after - late)]
            if first and after - first >= min_rows and acting.max() - max(acting[0], top) > beyond:
                found.append((first, after))
        if found:
            time = window.period * sum(after - first - 1 for first, after in found)
            message = f"joint_pos/{joint} stays at its extreme {sign * top:.4g} rad for {time:.2f} s in total while "
            message += "its command continues"
            remedy = "keep it if the limit is to be identified; otherwise command less, or delete these rows"
            yield Finding("warning", "saturation", time, message, remedy, joint, found[0][0])


def copied(log: MotorLog) -> Iterator[Finding]:
    """Angles that equal their command in more than 90 % of the rows in which it changes (error)."""
    for column in excited_joints(log):
        command = log.position_target[:, column]
        joint = log.joint_names[column]
        rows = 1 + np.flatnonzero(np.diff(command))
        same = np.abs(log.joint_pos[rows, column] - command[rows]) <= 1e-6
        if len(rows) >= 5 and same.mean() > 0.9:
            message = f"joint_pos/{joint} equals its command in {100 * same.mean():.4g} % of the rows in which it "
            remedy = f"the command is recorded twice: check the columns of the file, and their names {IN_MAP}"
            row = int(rows[np.argmax(same)])
            yield Finding(
                "error", "copied", float(same.mean()), f"{message}changes", remedy, joint, row
            )


def velocity(log: MotorLog) -> Iterator[Finding]:
    """Slope of the integral of joint_vel against the change of joint_pos over 0.1 s, insensitive to encoder steps."""
    if log.joint_vel is None:
        return
    width = max(1, round(0.1 / log.period))
    integrated = []
    moved = []
    for part in log.segments():
        assert part.joint_vel is not None
        usable = np.where(velocity_spikes(part.joint_vel), 0.0, part.joint_vel)
        steps = np.diff(part.time)[:, None] * 0.5 * (usable[1:] + usable[:-1])
        integral = np.concatenate([np.zeros((1, log.num_joints)), np.cumsum(steps, axis=0)])
        integrated.append(integral[width:] - integral[:-width])
        moved.append(part.joint_pos[width:] - part.joint_pos[:-width])
    for joint, one, other in zip(
        log.joint_names, np.concatenate(integrated).T, np.concatenate(moved).T, strict=True
    ):
        if len(other) < MIN_ROWS or np.std(other) < 1e-3:
            continue
        slope = float(other @ one / (other @ other))
        correlation = float(other @ one / max(np.sqrt((one @ one) * (other @ other)), 1e-300))
        message = f"{joint}: integrated joint_vel is {slope:.3g} times the change of joint_pos"
        if VELOCITY_SLOPES[0] <= slope <= VELOCITY_SLOPES[1]:
            yield Finding("info", "velocity", slope, message, joint=joint)
            continue
        remedy = f'correct its joint order, gear, sign or unit {IN_MAP} (velocity = "deg/s"), or leave it out'
        message += f", outside {VELOCITY_SLOPES[0]} to {VELOCITY_SLOPES[1]} (correlation {correlation:.2f})"
        # sign, or deg/s, rpm
        wrong = abs(correlation) > MIN_CORRELATION and (slope < 0.0 or slope > 5.0)
        yield Finding("error" if wrong else "warning", "velocity", slope, message, remedy, joint)


CHECKS = (excitation, frozen_angle, copied, velocity)
