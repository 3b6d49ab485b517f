"""Checks of motion: excitation, dead channels, tracking, velocity against angle, end stops.

A window is one joint on a uniform grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

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

MIN_CORRELATION = 0.5  # of an angle with its command
VELOCITY_SLOPES = (0.7, 1.4)  # plausible velocity / derivative of the angle
TRAVEL = 0.1  # share of its range by which the command continues beyond an end stop
MAX_OFFSET = 1.2  # maximum offset of an angle from its command [rad]; loads deflect servos less
CERTAIN_CORRELATION = 0.8  # correlation above which sign and order of a joint are certain
RATIOS = (0.1, 3.0)  # plausible motion / command; others mean a failed motion or another unit
MIN_REVERSALS = 4
# size of a window
MIN_ROWS = 20
MAX_ROWS = 20_000
# remedies
COMPARE = "compare sign and order of the joints, and the clocks of command and angle"
OTHER_SIGN = (
    f"reverse one {IN_MAP}: sign = -1 in [joints.….joint_pos] or [joints.….position_target]"
)
OTHER_ORDER = (
    f"commands and angles have different orders of joints: correct the column names {IN_MAP}"
)


def excited_window(log: MotorLog, column: int) -> tuple[slice, MotorLog] | None:
    """The window without gaps in which the command of a joint travels farthest.

    A window has at most 20 000 rows. Returns its rows, and that joint alone on a uniform grid with
    the period of new readings; None if the command moves in no window of 20 new readings.
    """
    repeated = repeated_rows(log)
    command = log.position_target[:, column]
    max_travel = 0.0
    window = None
    for rows in _windows(log):
        travel = float(np.abs(np.diff(command[rows])).sum())
        moves = np.std(command[rows]) > EXCITED_STD
        if moves and travel > max_travel and np.sum(~repeated[rows]) > MIN_ROWS:
            max_travel = travel
            window = slice(int(rows[0]), int(rows[-1]) + 1)
    if window is None:
        return None
    period = log.rows(window).rows(~repeated[window]).period
    return window, resample(log.joint(column).rows(window), period)


def _windows(log: MotorLog) -> Iterator[np.ndarray]:
    """Rows without gaps, at most MAX_ROWS together."""
    starts = {segment.start for segment in log.segment_slices()} | set(gap_rows(log).tolist())
    for rows in np.split(np.arange(log.num_rows), sorted(starts - {0})):
        yield from np.split(rows, range(MAX_ROWS, len(rows), MAX_ROWS))


def excitation(log: MotorLog) -> Iterator[Finding]:
    """Joints that are not commanded, move far less or more than commanded, or reverse rarely."""
    excited = excited_joints(log)
    if not excited.size:
        yield Finding(
            "error", "excitation", 0.0, "no joint is excited", "record commands that move"
        )
    for column, joint in enumerate(log.joint_names):
        std = float(np.std(log.position_target[:, column]))
        if column in excited:
            yield from _motion(log, column, std)
        else:
            message = (
                f"{joint} is not excited: standard deviation of its command {1e3 * std:.3f} mrad"
            )
            yield Finding("info", "excitation", std, message, joint=joint)


def _motion(log: MotorLog, column: int, command_std: float) -> Iterator[Finding]:
    """Too little, too much, or rarely reversed motion of a commanded joint."""
    joint = log.joint_names[column]
    angle = log.joint_pos[:, column]

    ratio = float(np.std(angle)) / command_std
    low, high = RATIOS
    if not low <= ratio <= high:
        message = f"{joint} moves {ratio:.3g} times its command, outside {low:g} to {high:g}"
        remedy = (
            f"check power, homing, joint order, and units {IN_MAP}: "
            'angle = "deg" in [joints.….joint_pos]'
        )
        yield Finding("warning", "excitation", ratio, message, remedy, joint)

    count = sum(reversals(angle[segment]) for segment in log.segment_slices())
    if count < MIN_REVERSALS:
        message = (
            f"{joint}: {count} reversals, fewer than {MIN_REVERSALS}: "
            "friction and backlash need reversals"
        )
        remedy = "record motions back and forth"
        yield Finding("warning", "reversals", count, message, remedy, joint)


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
    """Angles that rest for 0.5 s, away from end stops, while the command moves.

    The command moves by half of its range and 0.1 rad. The last 0.25 s do not count, as a servo
    responds late.
    """
    segment_starts = [segment.start for segment in log.segment_slices()]
    lag = round(MAX_LAG / log.period)
    for column in excited_joints(log):
        joint = log.joint_names[column]
        command = log.position_target[:, column]
        angle = log.joint_pos[:, column]
        min_travel = max(0.1, 0.5 * np.ptp(command))

        is_still = np.diff(angle, prepend=np.nan) == 0.0
        is_still[segment_starts] = False
        for first_repeat, end in runs_of_true(is_still).tolist():
            row = first_repeat - 1
            seconds = float(log.time[end - 1] - log.time[row])
            travel = np.ptp(command[row : max(row + 1, end - lag)])
            at_stop = angle[row] in (angle.min(), angle.max()) and np.ptp(angle) > 0.0
            if seconds >= 0.5 and travel > min_travel and not at_stop:
                message = (
                    f"joint_pos/{joint} does not change for {seconds:.2f} s from row {row} "
                    f"while its command moves by {travel:.2g} rad"
                )
                remedy = "check sensor, power and bus; record again, or delete these rows"
                yield Finding("warning", "dead", seconds, message, remedy, joint, row)
                break


class Peaks(NamedTuple):
    """Correlation of an angle with its command at several delays, and its first peaks."""

    correlation: np.ndarray  # with the command k rows earlier, k = -zero_lag, …, lag
    zero_lag: int
    late: int  # k >= 0 of the first positive peak
    opposed: int  # k >= 0 of the first negative peak


def correlation_peaks(window: MotorLog) -> Peaks:
    """Correlation of the angle with earlier and later commands, over the same rows of the angle."""
    command = window.position_target[:, 0]
    angle = window.joint_pos[:, 0]
    lag = min(int(0.5 / window.period), len(angle) // 2)  # 0.5 s later
    zero_lag = min(max(1, int(0.25 / window.period)), len(angle) // 4)  # to 0.25 s earlier

    rows = slice(lag, len(angle) - zero_lag)
    motion = angle[rows] - angle[rows].mean()
    r = np.zeros(zero_lag + lag + 1)
    for index in range(len(r)):
        shifted = command[lag + zero_lag - index :][: len(motion)]
        shifted = shifted - shifted.mean()
        norm = np.sqrt((shifted @ shifted) * (motion @ motion))
        r[index] = shifted @ motion / max(norm, 1e-300)

    from_zero = r[zero_lag - 1 :]
    return Peaks(r, zero_lag, _first_peak(from_zero), _first_peak(-from_zero))


def _first_peak(r: np.ndarray) -> int:
    """Index of the first peak of r[1:] above 95 % of the highest.

    Equal peaks of a sine are one period apart. Ripple is no peak: r must fall by 0.1 between a peak
    and the highest.
    """
    highest = 1 + int(np.argmax(r[1:]))
    for index in range(1, highest):
        is_high = r[index] >= max(r[index - 1], r[index + 1], 0.95 * r[highest])
        if is_high and r[index:highest].min() < r[index] - 0.1:
            return index - 1
    return highest - 1


def tracking(window: MotorLog) -> Iterator[Finding]:
    """Sign, joint order, lag and offset of the angle against the command.

    They come from the first peak of their correlation. An angle opposes its command if the negative
    peak within a servo's lag is larger than the positive one.
    """
    peaks = correlation_peaks(window)
    yield _tracking(window, peaks)

    joint = window.joint_names[0]
    offset = float(np.median(window.joint_pos - window.position_target))
    follows = float(peaks.correlation[peaks.zero_lag + peaks.late])
    if abs(offset) > MAX_OFFSET and follows >= MIN_CORRELATION:
        message = f"{joint} is {offset:+.2f} rad off its command (median), more than {MAX_OFFSET}"
        remedy = (
            "if no load deflects it so far, correct the zero of command or angle in the file, "
            f"or {IN_MAP}"
        )
        yield Finding("warning", "offset", offset, message, remedy, joint)


def _tracking(window: MotorLog, peaks: Peaks) -> Finding:
    r, zero_lag, late, opposed = peaks
    joint = window.joint_names[0]
    period = window.period
    seconds = late * period
    follows = float(r[zero_lag + late])
    opposes = float(r[zero_lag + opposed])

    described = (
        f"{joint} follows its command {1e3 * seconds:.3g} ms later, correlation {follows:.2f}"
    )
    opposed_ms = 1e3 * opposed * period
    against = f"moves against its command {opposed_ms:.3g} ms later, correlation {opposes:.2f}"

    can_oppose = opposes < -MIN_CORRELATION and opposed * period < MAX_LAG
    followed_in_time = follows if seconds < MAX_LAG else 0.0
    if can_oppose and -opposes - followed_in_time > 0.1:
        remedy = OTHER_SIGN if -opposes > CERTAIN_CORRELATION else COMPARE
        return Finding("error", "tracking", opposes, f"{joint} {against}", remedy, joint)

    if follows < MIN_CORRELATION:
        message = f"{described}, below {MIN_CORRELATION}"
        remedy = (
            "check power, joint order and clocks; or command more than the dead band of the servo"
        )
        return Finding("warning", "tracking", follows, message, remedy, joint)

    if can_oppose and opposed < late and seconds < MAX_LAG:
        message = f"{described}, or {against}"
        remedy = "record more than one frequency, or a step: the lag of one sine is ambiguous"
        return Finding("warning", "tracking", seconds, message, remedy, joint)

    # rows before the command, while the correlation rises
    ahead = int(np.argmin(np.append(np.diff(r[zero_lag::-1]) > 0.0, False)))
    is_closer_ahead = 1.0 - r[zero_lag - ahead] <= 0.2 * (1.0 - r[zero_lag])
    if ahead * period >= 0.015 and is_closer_ahead:
        message = f"{joint} moves {1e3 * ahead * period:.3g} ms before its command"
        remedy = (
            "command and measurement have different clocks, or are in different rows: put them "
            "on one clock"
        )
        return Finding("warning", "tracking", -ahead * period, message, remedy, joint)

    speed = float(np.percentile(np.abs(np.diff(window.position_target[:, 0])), 95)) / period
    # [rad]; less may be dead band and friction
    if seconds > MAX_LAG and seconds * speed > 0.1:
        message = f"{described}, above {1e3 * MAX_LAG:g} ms"
        remedy = "check the clocks of command and measurement"
        return Finding("warning", "tracking", seconds, message, remedy, joint)
    return Finding("info", "tracking", seconds, described, "", joint)


def followed_joint(log: MotorLog, rows: slice, window: MotorLog, columns: Sequence[int]) -> str:
    """Name of the other joint whose command the angle of a window follows best, or "".

    ``columns`` are the joints to try. The angle must follow clearly, within a servo's lag.
    """
    grid = resample(log.rows(rows), window.period)
    best = CERTAIN_CORRELATION
    name = ""
    for column in columns:
        command = grid.position_target[:, [column]]
        r, zero_lag, late, _ = correlation_peaks(replace(window, position_target=command))
        if late * window.period < MAX_LAG and r[zero_lag + late] > best:
            best = float(r[zero_lag + late])
            name = log.joint_names[column]
    return "" if name == window.joint_names[0] else name


def saturation(window: MotorLog) -> Iterator[Finding]:
    """An angle that rests at its extreme for 0.1 s while the command continues beyond it.

    The command, delayed by the lag, continues by 10 % of its range and 0.03 rad after the joint
    stopped. Friction and dead bands stop a joint only after a reversal.
    """
    joint = window.joint_names[0]
    r, zero_lag, late, _ = correlation_peaks(window)
    delay = 0
    if r[zero_lag + late] >= MIN_CORRELATION:
        delay = min(late, int(0.1 / window.period))
    min_rows = max(5, round(0.1 / window.period) + 1)  # reversals are shorter

    for sign in (1.0, -1.0):
        command = sign * window.position_target[:, 0]
        angle = sign * window.joint_pos[:, 0]
        top = angle.max()
        beyond = max(TRAVEL * np.ptp(command), 0.03)

        stops = []
        for first, after in runs_of_true(angle >= top - encoder_step(angle)).tolist():
            acting = command[max(0, first - delay) : max(1, after - delay)]
            continues = acting.max() - max(acting[0], top) > beyond
            if first and after - first >= min_rows and continues:
                stops.append((first, after))
        if stops:
            time = window.period * sum(after - first - 1 for first, after in stops)
            message = (
                f"joint_pos/{joint} stays at its extreme {sign * top:.4g} rad for {time:.2f} s "
                "in total while its command continues"
            )
            remedy = (
                "keep it if the limit is to be identified; otherwise command less, or delete "
                "these rows"
            )
            yield Finding("warning", "saturation", time, message, remedy, joint, stops[0][0])


def copied(log: MotorLog) -> Iterator[Finding]:
    """Angles that equal their command in over 90 % of the rows in which it changes (error)."""
    for column in excited_joints(log):
        joint = log.joint_names[column]
        command = log.position_target[:, column]
        rows = 1 + np.flatnonzero(np.diff(command))
        is_equal = np.abs(log.joint_pos[rows, column] - command[rows]) <= 1e-6
        if len(rows) >= 5 and is_equal.mean() > 0.9:
            share = float(is_equal.mean())
            message = (
                f"joint_pos/{joint} equals its command in {100 * share:.4g} % of the rows in "
                "which it changes"
            )
            remedy = (
                "the command is recorded twice: check the columns of the file, and their names "
                f"{IN_MAP}"
            )
            row = int(rows[np.argmax(is_equal)])
            yield Finding("error", "copied", share, message, remedy, joint, row)


def velocity(log: MotorLog) -> Iterator[Finding]:
    """Slope of the integral of joint_vel against the change of joint_pos over 0.1 s.

    It is insensitive to encoder steps.
    """
    if log.joint_vel is None:
        return
    integrals, changes = _displacements(log)
    for joint, integral, change in zip(log.joint_names, integrals.T, changes.T, strict=True):
        if len(change) < MIN_ROWS or np.std(change) < 1e-3:
            continue
        slope = float(change @ integral / (change @ change))
        norm = max(np.sqrt((integral @ integral) * (change @ change)), 1e-300)
        correlation = float(change @ integral / norm)

        message = f"{joint}: integrated joint_vel is {slope:.3g} times the change of joint_pos"
        low, high = VELOCITY_SLOPES
        if low <= slope <= high:
            yield Finding("info", "velocity", slope, message, joint=joint)
            continue
        message += f", outside {low} to {high} (correlation {correlation:.2f})"
        remedy = (
            f"correct its joint order, gear, sign or unit {IN_MAP} "
            '(velocity = "deg/s"), or leave it out'
        )
        # another sign, or deg/s or rpm
        is_certain = abs(correlation) > MIN_CORRELATION and (slope < 0.0 or slope > 5.0)
        severity = "error" if is_certain else "warning"
        yield Finding(severity, "velocity", slope, message, remedy, joint)


def _displacements(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """(N, J) integrals of joint_vel and changes of joint_pos over 0.1 s [rad]."""
    width = max(1, round(0.1 / log.period))
    integrals = []
    changes = []
    for segment in log.segments():
        assert segment.joint_vel is not None
        usable = np.where(velocity_spikes(segment.joint_vel), 0.0, segment.joint_vel)
        steps = np.diff(segment.time)[:, None] * 0.5 * (usable[1:] + usable[:-1])
        integral = np.concatenate([np.zeros((1, log.num_joints)), np.cumsum(steps, axis=0)])
        integrals.append(integral[width:] - integral[:-width])
        changes.append(segment.joint_pos[width:] - segment.joint_pos[:-width])
    return np.concatenate(integrals), np.concatenate(changes)


CHECKS = (excitation, frozen_angle, copied, velocity)
