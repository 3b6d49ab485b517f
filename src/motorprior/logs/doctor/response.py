"""Checks of motion: excitation, dead channels, tracking, velocity against angle, end stops.

A window is one joint on a uniform grid.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from motorprior.logs.command_modes import commands_angles
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

MIN_CORRELATION = 0.5  # minimum correlation of an angle with its command
VELOCITY_SLOPES = (0.7, 1.4)  # plausible range of joint_vel / derivative of joint_pos
# minimum motion of a command beyond an end stop: the larger of a share of the command's range, and
# an angle [rad]
MIN_CONTINUATION = 0.1
MIN_CONTINUATION_ANGLE = 0.03
STOP_SHARE = 0.005  # movement of a joint in its end stop, over the range of its angle
MAX_OFFSET = 1.2  # maximum offset of an angle from its command [rad]; loads deflect servos less
CERTAIN_CORRELATION = 0.8  # correlation above which sign and order of a joint are certain
# plausible range of the standard deviations' ratio angle / command; outside of it the motion failed
# or the units differ
MOTION_RATIOS = (0.1, 3.0)
# an angle with this correlation follows its command; its slope is then in a plausible range
SCALED_CORRELATION = 0.95
SCALES = (0.45, 2.0)
MIN_REVERSALS = 4
# minimum and maximum rows of a window
MIN_ROWS = 20
MAX_ROWS = 20_000
# remedies
COMPARE_JOINTS = "compare sign and order of the joints, and the clocks of command and angle"
OTHER_SIGN = (
    f"reverse one {IN_MAP}: sign = -1 in [joints.….joint_pos] or [joints.….position_target]"
)
OTHER_ORDER = (
    f"commands and angles have different orders of joints: correct the column names {IN_MAP}"
)


def excited_window(log: MotorLog, column: int) -> tuple[slice, MotorLog] | None:
    """The window without gaps in which the command of a joint travels farthest.

    A window has at most 20 000 rows. Returns the window's rows in the log, and a log of this joint
    in the window, on a uniform grid. The period of the grid is the median time between new
    readings: repeated rows do not count. Returns None if the command moves in no window of more
    than 20 new readings.
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
    new_readings = log.rows(window).rows(~repeated[window])
    return window, resample(log.joint(column).rows(window), new_readings.period)


def _windows(log: MotorLog) -> Iterator[np.ndarray]:
    """Rows of each window: without gaps, within a segment, and at most MAX_ROWS."""
    segment_starts = {segment.start for segment in log.segment_slices()}
    rows_after_gaps = set(gap_rows(log).tolist())
    cuts = sorted((segment_starts | rows_after_gaps) - {0})
    for rows in np.split(np.arange(log.num_rows), cuts):
        yield from np.split(rows, range(MAX_ROWS, len(rows), MAX_ROWS))


def excitation(log: MotorLog) -> Iterator[Finding]:
    """Joints that are not excited, move far less or more than commanded, or reverse rarely."""
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
    """Findings if the motion of a commanded joint is too small, too large, or rarely reversed."""
    joint = log.joint_names[column]
    angle = log.joint_pos[:, column]

    ratio = float(np.std(angle)) / command_std
    low, high = MOTION_RATIOS
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

    The command must move by more than half of its range in the log, and by more than 0.1 rad. Its
    motion in the last 0.25 s of the rest does not count, as a servo responds late.
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
            last_row = max(row + 1, end - lag)
            travel = np.ptp(command[row:last_row])
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
    """Correlation of an angle with its command at several delays, and its first peaks.

    A delay is a number of rows. It is negative if the angle moves before its command.
    """

    correlation: np.ndarray  # correlation at the delays -max_lead, …, max_delay; (delays,)
    zero_index: int  # index of the delay 0 in ``correlation``, which is max_lead
    delay: int  # delay of the first positive peak, at least 0
    opposed_delay: int  # delay of the first negative peak, at least 0


def correlation_peaks(window: MotorLog) -> Peaks:
    """Correlation of the angle with its command up to 0.5 s before and 0.25 s after it.

    Every correlation is over the same rows of the angle.
    """
    command = window.position_target[:, 0]
    angle = window.joint_pos[:, 0]
    max_delay = min(int(0.5 / window.period), len(angle) // 2)
    max_lead = min(max(1, int(0.25 / window.period)), len(angle) // 4)

    rows = slice(max_delay, len(angle) - max_lead)
    motion = angle[rows] - angle[rows].mean()
    r = np.zeros(max_lead + max_delay + 1)
    for index in range(len(r)):
        delay = index - max_lead
        first = max_delay - delay
        delayed_command = command[first : first + len(motion)]
        command_motion = delayed_command - delayed_command.mean()
        norm = np.sqrt((command_motion @ command_motion) * (motion @ motion))
        r[index] = command_motion @ motion / max(norm, 1e-300)

    from_minus_one = r[max_lead - 1 :]  # at the delays -1, 0, 1, …
    return Peaks(r, max_lead, _first_peak(from_minus_one), _first_peak(-from_minus_one))


def _first_peak(r: np.ndarray) -> int:
    """Delay of the first peak that has at least 95 % of the highest correlation.

    ``r`` are correlations at the delays -1, 0, 1, …; the first one is only a neighbour. A sine has
    equally high peaks, one period apart: the first one counts. Ripple does not count as a peak: r
    must fall by 0.1 between the peak and the highest one.
    """
    highest = 1 + int(np.argmax(r[1:]))
    for index in range(1, highest):
        is_peak = r[index] >= max(r[index - 1], r[index + 1])
        is_high = r[index] >= 0.95 * r[highest]
        if is_peak and is_high and r[index:highest].min() < r[index] - 0.1:
            return index - 1
    return highest - 1


def tracking(window: MotorLog) -> Iterator[Finding]:
    """Sign, joint order, lag and offset of the angle against the command.

    The lag is the delay of the first peak of their correlation. The angle moves against its command
    if the first negative peak is within a servo's lag, and is clearly larger than a positive peak
    within this lag.
    """
    peaks = correlation_peaks(window)
    yield _tracking(window, peaks)

    joint = window.joint_names[0]
    offset = float(np.median(window.joint_pos - window.position_target))
    positive_peak = float(peaks.correlation[peaks.zero_index + peaks.delay])
    if abs(offset) > MAX_OFFSET and positive_peak >= MIN_CORRELATION:
        message = f"{joint} is {offset:+.2f} rad off its command (median), more than {MAX_OFFSET}"
        remedy = (
            "if no load deflects it so far, correct the zero of command or angle in the file, "
            f"or {IN_MAP}"
        )
        yield Finding("warning", "offset", offset, message, remedy, joint)
    if positive_peak >= SCALED_CORRELATION:
        yield from _scale(window, peaks.delay)


def _scale(window: MotorLog, delay: int) -> Iterator[Finding]:
    """An angle that follows its command ``delay`` rows later, but with another amplitude."""
    joint = window.joint_names[0]
    count = window.num_rows - delay
    command = window.position_target[:count, 0]
    angle = window.joint_pos[delay:, 0]
    variance = float(np.var(command))
    if variance == 0.0:
        return
    slope = float(np.mean((command - command.mean()) * angle)) / variance
    low, high = SCALES
    is_failed_motion = not MOTION_RATIOS[0] <= slope <= MOTION_RATIOS[1]
    if low <= slope <= high or is_failed_motion:
        return
    message = f"{joint} moves {slope:.2g} times its command"
    remedy = f"scaled actions, or another unit? set scale {IN_MAP}, in [joints.….position_target]"
    yield Finding("warning", "scale", slope, message, remedy, joint)


def _tracking(window: MotorLog, peaks: Peaks) -> Finding:
    """The finding about sign, joint order and lag."""
    r, zero_index, delay, opposed_delay = peaks
    joint = window.joint_names[0]
    period = window.period
    seconds = delay * period
    positive_peak = float(r[zero_index + delay])
    negative_peak = float(r[zero_index + opposed_delay])

    described = (
        f"{joint} follows its command {1e3 * seconds:.3g} ms later, correlation {positive_peak:.2f}"
    )
    opposed_ms = 1e3 * opposed_delay * period
    against = (
        f"moves against its command {opposed_ms:.3g} ms later, correlation {negative_peak:.2f}"
    )

    can_oppose = negative_peak < -MIN_CORRELATION and opposed_delay * period < MAX_LAG
    positive_peak_in_time = positive_peak if seconds < MAX_LAG else 0.0
    if can_oppose and -negative_peak - positive_peak_in_time > 0.1:
        is_certain = -negative_peak > CERTAIN_CORRELATION
        return Finding(
            "error",
            "tracking",
            negative_peak,
            f"{joint} {against}",
            OTHER_SIGN if is_certain else COMPARE_JOINTS,
            joint,
            is_sign_error=is_certain,
        )

    if positive_peak < MIN_CORRELATION:
        message = f"{described}, below {MIN_CORRELATION}"
        remedy = (
            "check power, joint order and clocks; or command more than the dead band of the servo"
        )
        return Finding("warning", "tracking", positive_peak, message, remedy, joint)

    if can_oppose and opposed_delay < delay and seconds < MAX_LAG:
        message = f"{described}, or {against}"
        remedy = "record more than one frequency, or a step: the lag of one sine is ambiguous"
        return Finding("warning", "tracking", seconds, message, remedy, joint)

    # the number of rows before the command over which the correlation rises
    ahead = 0
    while ahead < zero_index and r[zero_index - ahead - 1] > r[zero_index - ahead]:
        ahead += 1
    deviation_ahead = 1.0 - r[zero_index - ahead]
    deviation_at_zero = 1.0 - r[zero_index]
    is_closer_ahead = deviation_ahead <= 0.2 * deviation_at_zero
    if ahead * period >= 0.015 and is_closer_ahead:
        message = f"{joint} moves {1e3 * ahead * period:.3g} ms before its command"
        remedy = (
            "command and measurement have different clocks, or are in different rows: put them "
            "on one clock"
        )
        return Finding("warning", "tracking", -ahead * period, message, remedy, joint)

    speed = float(np.percentile(np.abs(np.diff(window.position_target[:, 0])), 95)) / period
    # A lag of less than 0.1 rad at the command's speed may come from dead band and friction.
    if seconds > MAX_LAG and seconds * speed > 0.1:
        message = f"{described}, above {1e3 * MAX_LAG:g} ms"
        remedy = "check the clocks of command and measurement"
        return Finding("warning", "tracking", seconds, message, remedy, joint)
    return Finding("info", "tracking", seconds, described, "", joint)


def followed_joint(log: MotorLog, rows: slice, window: MotorLog, columns: Sequence[int]) -> str:
    """Name of the joint whose command the angle of a window follows best.

    ``columns`` are the joints to try. The result is "" if it is the window's own joint, or if the
    angle follows no command with a correlation above CERTAIN_CORRELATION within a servo's lag.
    """
    grid = resample(log.rows(rows), window.period)
    best = CERTAIN_CORRELATION
    name = ""
    for column in columns:
        command = grid.position_target[:, [column]]
        peaks = correlation_peaks(replace(window, position_target=command))
        correlation = float(peaks.correlation[peaks.zero_index + peaks.delay])
        if peaks.delay * window.period < MAX_LAG and correlation > best:
            best = correlation
            name = log.joint_names[column]
    return "" if name == window.joint_names[0] else name


def saturation(window: MotorLog) -> Iterator[Finding]:
    """An angle that rests at its extreme for 0.1 s while the command continues beyond it.

    After the joint stopped, the command, delayed by the lag, must go on by more than 10 % of its
    range, and by more than 0.03 rad. It cannot be friction or a dead band: these stop a joint only
    after a reversal.
    """
    joint = window.joint_names[0]
    peaks = correlation_peaks(window)
    delay = 0
    if peaks.correlation[peaks.zero_index + peaks.delay] >= MIN_CORRELATION:
        delay = min(peaks.delay, int(0.1 / window.period))
    min_rows = max(5, round(0.1 / window.period) + 1)  # reversals are shorter

    for sign in (1.0, -1.0):
        command = sign * window.position_target[:, 0]
        angle = sign * window.joint_pos[:, 0]
        top = angle.max()
        min_continuation = max(MIN_CONTINUATION * np.ptp(command), MIN_CONTINUATION_ANGLE)

        # an end stop gives way a little, and readings have noise
        tolerance = max(encoder_step(angle), STOP_SHARE * np.ptp(angle))
        stops = []
        for first, after in runs_of_true(angle >= top - tolerance).tolist():
            acting_start = max(0, first - delay)
            acting_stop = max(1, after - delay)
            acting_command = command[acting_start:acting_stop]
            continuation = acting_command.max() - max(acting_command[0], top)
            is_long = after - first >= min_rows
            if first and is_long and continuation > min_continuation:
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
    is_commanded = commands_angles(log)
    for column in excited_joints(log):
        if not is_commanded[column]:
            continue
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

    The slope is 1 for correct velocities, and insensitive to encoder steps.
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
        # another sign, or another unit such as deg/s or rpm
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
