"""Checks of readings: rate, gaps, repeated rows, jumps, and implausible angles and speeds."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog, settings_text, time_steps
from motorprior.logs.operations import GAP_FACTOR, gap_rows, repeated_rows
from motorprior.robots.robot import Robot
from motorprior.signals import encoder_step

# plausible range of the rate of a motor log [Hz]; outside of it the unit of time is another one
RATES = (5.0, 2e4)
MAX_JITTER = 0.5  # maximum jitter without a warning, see `rate`
# minimum number of straight pieces of an interpolated angle, and minimum of the lower quartile of
# their rows
MIN_SPANS = 10
MIN_SPAN = 3
MIN_BEND_RATIO = 3.0  # minimum ratio of the median bend between pieces to bends by rounding
MAX_ROUNDING = 1e-6  # resolution of angles [rad] and times [s] in files with few decimals
MAX_FAILED = 5  # maximum length of a failed read [readings]
MAX_LAG = 0.25  # maximum lag of a servo behind its command [s]
MAX_TURNS = 4.0  # maximum angle of a joint without known limits [turns]
MAX_SPEED = 100.0  # speed that no geared joint reaches [rad/s]
# ways in which a reading jumps
FAILED = "and back (failed read)"
STAYS = "and stays"
WRAPS = "by a turn"
LEFT_OUT = "check the bus; mp.load_log and `motorprior logs import` leave these rows out"
_UNITS = f'convert them in the file, or state their unit {IN_MAP}: angle = "deg", "turn" or "tick"'
REMEDIES = {
    WRAPS: f"state wraps = true for the joint {IN_MAP}; or unwrap angle and command in the file by "
    "numpy.unwrap(column, period=one turn in the column's unit: 4096 for such ticks, 360 for "
    "degrees, 2π for rad)",
    FAILED: f"{LEFT_OUT}; or delete these rows from the file",
    STAYS: "check bus, power and homing; delete the wrong rows, or begin a segment there "
    f"{IN_MAP} by segment",
}


def rate(log: MotorLog) -> Iterator[Finding]:
    """Rate [Hz] and jitter of the rows.

    The rate is 1 / median time step. The jitter is (95th - 5th percentile of the time steps) /
    median time step.
    """
    rows, steps = time_steps(log)
    median = float(np.median(steps))
    hertz = 1.0 / median
    high, low = np.percentile(steps, [95, 5])
    jitter = float(high - low) / median
    message = (
        f"median time step {1e3 * median:.3g} ms ({hertz:.4g} Hz), jitter {jitter:.2f} of the step"
    )

    lowest, highest = RATES
    if not 0.99 * lowest <= hertz <= 1.01 * highest:
        message += f"; outside {lowest:g} to {highest:g} Hz"
        remedy = (
            f"convert the time in the file, or state its unit {IN_MAP}: "
            'time = "s", "ms", "us" or "ns"; or record faster'
        )
        yield Finding("error", "rate", hertz, message, remedy)
        return

    yield Finding("info", "rate", hertz, message)
    if jitter > MAX_JITTER:
        is_uneven = np.abs(steps - median) > 0.5 * MAX_JITTER * median
        row = int(rows[np.argmax(is_uneven)])
        message += f", more than {MAX_JITTER}"
        remedy = (
            "import with a period; if these are times of arrival, record the robot's or state "
            f"rate = … {IN_MAP}"
        )
        yield Finding("warning", "jitter", jitter, message, remedy, row=row)


def gaps(log: MotorLog) -> Iterator[Finding]:
    """Time steps of more than 5 medians of the steps in their segment."""
    rows = gap_rows(log)
    if rows.size:
        steps = log.time[rows] - log.time[rows - 1]
        message = (
            f"{len(rows)} gaps longer than {GAP_FACTOR:g} median steps, the longest "
            f"{1e3 * steps.max():.3g} ms"
        )
        remedy = (
            "find out why rows are lost; mp.load_log and `motorprior logs import` begin a segment "
            "after each gap"
        )
        yield Finding("warning", "gaps", float(steps.max()), message, remedy, row=int(rows[0]))


def repeats(log: MotorLog) -> Iterator[Finding]:
    """Angles that repeat in fast motion: of all joints, or of one joint.

    The angles of all joints repeat in rows without new readings; the angle of one joint repeats if
    the joints are read in turn. Slow motion does not count: an angle that moves by less than an
    encoder step per row repeats in any log.
    """
    whole_rows = repeated_rows(log)
    travels = [_travel(angle) for angle in log.joint_pos.T]
    yield from _repeats(log, None, whole_rows, np.max(travels, axis=0), 0.05)
    for column, joint in enumerate(log.joint_names):
        rows_of_joint = repeated_rows(log.joint(column)) & ~whole_rows
        yield from _repeats(log, joint, rows_of_joint, travels[column], 0.4)


def _repeats(
    log: MotorLog, joint: str | None, repeated: np.ndarray, travel: np.ndarray, bound: float
) -> Iterator[Finding]:
    """The finding if the share of ``repeated`` rows in fast motion exceeds ``bound``.

    Motion is fast if its ``travel`` is in the upper quartile.
    """
    is_fast = travel > 0.0
    if is_fast.any():
        is_fast = travel >= np.percentile(travel[is_fast], 75)
    if is_fast.sum() < 20:
        return
    share = float(repeated[is_fast].mean())
    if min(share, repeated.mean()) <= bound:
        return

    new_period = log.rows(~repeated).period
    message = (
        f"{100 * share:.3g} % of the rows repeat the angle of {joint or 'all joints'} in fast "
        f"motion (bound {100 * bound:g} %): new readings every {1e3 * new_period:.3g} ms, rows "
        f"every {1e3 * log.period:.3g} ms"
    )
    remedy = (
        "record one row per new reading of all joints, or import with a period no shorter than "
        "theirs"
    )
    yield Finding("warning", "repeats", share, message, remedy, joint, int(np.argmax(repeated)))


def interpolated(log: MotorLog) -> Iterator[Finding]:
    """Joints whose angle moves on straight lines between readings several rows apart.

    Angle and time of a row are rounded by half a resolution each way, so that the slope of a
    straight line changes by up to 2·(resolution of the angle + slope·resolution of time)/period.
    """
    for column, joint in enumerate(log.joint_names):
        rounding = _rounding(log.joint_pos[:, column])
        spans = []
        for segment in log.segment_slices():
            slopes = np.diff(log.joint_pos[segment, column]) / np.diff(log.time[segment])
            steepest = float(np.abs(slopes).max(initial=0.0))
            min_bend = 2.0 * (rounding + MAX_ROUNDING * steepest) / log.period
            changes = np.abs(np.diff(slopes))
            is_bend = changes > min_bend
            # the bends of smooth, slow motion hardly exceed the rounding
            if not is_bend.any() or np.median(changes[is_bend]) < MIN_BEND_RATIO * min_bend:
                continue
            bends = 1 + np.flatnonzero(is_bend)
            # a joint at rest is straight as well
            moves = np.abs(slopes[bends[:-1]]) > min_bend
            spans += np.diff(bends)[moves].tolist()
        # a resampled angle has two bends per reading, and every other span is short
        if len(spans) < MIN_SPANS or np.quantile(spans, 0.25) < MIN_SPAN:
            continue
        rows = float(np.median(spans))
        message = (
            f"the angle of {joint} is a straight line over every {rows:.3g} rows: it was read "
            f"every {1e3 * rows * log.period:.3g} ms and interpolated"
        )
        remedy = "record this joint at the rate of the others; its constants are less accurate"
        yield Finding("warning", "interpolated", rows, message, remedy, joint)


def _rounding(angle: np.ndarray) -> float:
    """Resolution [rad] of a column: its smallest difference, at most MAX_ROUNDING, or float32's.

    A larger difference is the step of an encoder.
    """
    smallest = np.diff(np.unique(angle)).min(initial=MAX_ROUNDING)
    return float(max(smallest, np.spacing(np.float32(np.abs(angle).max()))))


def _travel(angle: np.ndarray) -> np.ndarray:
    """(T,) the smaller of a joint's displacements in the 5 rows before and the 5 rows after a row.

    A displacement of less than 10 encoder steps counts as 0.
    """
    displacement = np.abs(angle[5:] - angle[:-5])
    travel = np.zeros(len(angle))
    travel[5:-5] = np.minimum(displacement[5:], displacement[:-5])
    return np.where(travel >= 10.0 * encoder_step(angle), travel, 0.0)


class Jump(NamedTuple):
    """A row in which a channel of a joint jumps."""

    channel: str
    way: str  # FAILED, STAYS or WRAPS
    row: int


def jumps(log: MotorLog) -> Iterator[Finding]:
    """Errors: failed reads, encoders and commands that wrap by a turn, and lasting jumps.

    After a failed read the angle is back within five readings.
    """
    period = _reading_period(log)
    for column, joint in enumerate(log.joint_names):
        rows_of_jumps: dict[tuple[str, str], list[int]] = {}
        for channel, way, row in _jumps(log, column, period):
            rows_of_jumps.setdefault((channel, way), []).append(row)
        for (channel, way), rows in rows_of_jumps.items():
            row = rows[0]
            angles = getattr(log, channel)[:, column]
            previous = float(angles[row - 1])
            angle = float(angles[row])
            message = (
                f"{channel}/{joint} jumps from {previous:.4g} to {angle:.4g} rad in row {row}, "
                f"{way}; {len(rows)} such rows"
            )
            yield Finding("error", "jumps", angle - previous, message, REMEDIES[way], joint, row)


def failed_reads(log: MotorLog) -> np.ndarray:
    """(T, J) mask of rows in which a read of a joint failed.

    A read failed if the angle jumps and comes back within 5 readings, if it jumps within 5 readings
    of an end of its segment, or if the velocity is a spike (`velocity_spikes`).
    """
    failed = np.zeros(log.joint_pos.shape, dtype=bool)
    period = _reading_period(log)
    segments = log.segment_slices()
    for column in range(log.num_joints):
        for _, way, row in _jumps(log, column, period):
            segment = next(rows for rows in segments if rows.start <= row < rows.stop)
            if way == FAILED:
                failed[row, column] = True
            elif way == STAYS and row - segment.start <= MAX_FAILED:
                failed[segment.start : row, column] = True
            elif way == STAYS and segment.stop - row <= MAX_FAILED:
                failed[row : segment.stop, column] = True
    if log.joint_vel is None:
        return failed
    return failed | velocity_spikes(log.joint_vel)


def velocity_spikes(velocity: np.ndarray) -> np.ndarray:
    """(T, J) mask of single readings of an impossible velocity.

    A spike exceeds MAX_SPEED, and five times the median of the 11 readings around it. A joint that
    really moves so fast, or whose velocity has another unit, is as fast before and after.
    """
    speed = np.abs(velocity)
    mode = "reflect" if len(speed) > MAX_FAILED else "edge"
    padded = np.pad(speed, ((MAX_FAILED, MAX_FAILED), (0, 0)), mode)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * MAX_FAILED + 1, axis=0)
    usual_speed = np.median(windows, axis=-1)
    return (speed > MAX_SPEED) & (speed > 5.0 * usual_speed)


def _reading_period(log: MotorLog) -> float:
    """Median time between new readings [s]: a host may poll faster than the robot answers."""
    _, steps = time_steps(log.rows(~repeated_rows(log)))
    if not steps.size:
        return log.period
    return min(5.0 * log.period, float(np.median(steps)))


def _jumps(log: MotorLog, column: int, period: float) -> Iterator[Jump]:
    """Jumps of one joint; ``period`` is the time between new readings [s].

    A jump exceeds 3·u, 10 encoder steps (at most 0.3 rad), 10 rad/s and 0.03 rad. The usual step u
    is the sixth largest |median(Δ[k-1], Δ[k], Δ[k+1])| over the steps Δ: fast motion increases u, a
    failed read does not. `_spikes` also finds single readings that jump and come back during slow
    motion.
    """
    angle = log.joint_pos[:, column]
    command_steps = _steps(log, log.position_target[:, column])
    if np.ptp(angle) <= 0.5 * math.tau:
        is_turn = np.abs(np.abs(command_steps) - math.tau) < 0.3
        for row in np.flatnonzero(is_turn).tolist():
            yield Jump("position_target", WRAPS, row)

    steps = _steps(log, angle)
    rows = np.flatnonzero(steps)  # a held angle has no steps
    steps = steps[rows]
    usual = _usual_step(steps)
    min_jump = max(min(10.0 * encoder_step(angle), 0.3), 10.0 * period, 0.03)
    bound = max(3.0 * usual, min_jump)

    spikes = set(_spikes(angle, log.segment_slices(), min_jump))
    yield from (Jump("joint_pos", FAILED, row) for row in sorted(spikes))

    lag = 1 + int(MAX_LAG / log.period)
    places = np.flatnonzero(np.abs(steps) > bound)[:10_000]
    row_back = 0  # row in which the angle is back after the last failed read
    for number, place in enumerate(places.tolist()):
        row = int(rows[place])
        if row < row_back or row in spikes or row - 1 in spikes:
            continue

        size = abs(float(steps[place]))
        if abs(size - math.tau) <= bound:
            yield Jump("joint_pos", WRAPS, row)
            continue

        last_command_steps = command_steps[max(1, row - lag + 1) : row + 1]
        if np.abs(last_command_steps).max(initial=0.0) >= 0.5 * size:
            continue  # the command stepped, too

        later = places[number + 1 : number + 1 + MAX_FAILED]
        angle_change = np.abs(angle[rows[later]] - angle[row - 1])
        waited = log.time[rows[later]] - log.time[row]
        is_back = angle_change <= np.maximum(0.25 * size, usual * (later - place + 1))
        is_back &= (waited >= 0.0) & (waited <= 1.01 * MAX_FAILED * period)
        if is_back.any():
            row_back = int(rows[later[np.argmax(is_back)]])
            yield from (Jump("joint_pos", FAILED, failed) for failed in range(row, row_back))
            continue

        # a joint would accelerate over several rows
        speed = size / max(period, float(log.time[row] - log.time[row - 1]))
        near = _steps_near(place, steps, log.time[rows], 3.5 * period)
        if speed > 50.0 and near.max(initial=0.0) <= 0.125 * size:
            yield Jump("joint_pos", STAYS, row)


def _steps(log: MotorLog, values: np.ndarray) -> np.ndarray:
    """(T,) steps to each row; 0 in the first row of a segment."""
    steps = np.diff(values, prepend=values[0])
    steps[[segment.start for segment in log.segment_slices()]] = 0.0
    return steps


def _usual_step(steps: np.ndarray) -> float:
    """The usual step u of `_jumps` [rad]; steps by whole turns count as 0."""
    moves = np.pad(steps - math.tau * np.rint(steps / math.tau), 1)
    medians = np.median([moves[:-2], moves[1:-1], moves[2:]], axis=0)
    return float(np.sort(np.append(np.zeros(6), np.abs(medians)))[-6])


def _steps_near(place: int, steps: np.ndarray, time: np.ndarray, seconds: float) -> np.ndarray:
    """Sizes of up to three steps before and three after one step, within ``seconds`` of it."""
    around = np.arange(max(0, place - 3), min(len(steps), place + 4))
    around = np.delete(around, min(place, 3))
    is_near = np.abs(time[around] - time[place]) <= seconds
    return np.abs(steps[around[is_near]])


def _spikes(angle: np.ndarray, segments: Sequence[slice], min_jump: float) -> Iterator[int]:
    """Rows of single readings that jump and come back.

    Both steps, out and back, exceed ``min_jump`` [rad], and 8 times the motion around them. This
    motion is the largest of the step before them, the step after them, and their sum.
    """
    for segment in segments:
        steps = np.diff(angle[segment])
        if len(steps) < 4:
            continue
        out = steps[1:-2]
        back = steps[2:-1]
        motion = np.max(np.abs([steps[:-3], out + back, steps[3:]]), axis=0)
        smaller_step = np.minimum(np.abs(out), np.abs(back))
        is_spike = (out * back < 0.0) & (smaller_step > np.maximum(min_jump, 8.0 * motion))
        yield from (segment.start + 2 + np.flatnonzero(is_spike)).tolist()


def angle_limits(log: MotorLog, robot: Robot | None = None) -> Iterator[Finding]:
    """Angles outside the limits of the robot, or too large for a joint without limits.

    An angle beyond one turn is a warning, an angle beyond four turns an error.
    """
    limits = np.full((log.num_joints, 2), np.nan)
    if robot is not None:
        limits = robot.limits_of(log.joint_names)
        yield from _unknown_limits(log, limits)
    for channel in ("position_target", "joint_pos"):
        series = zip(log.joint_names, getattr(log, channel).T, limits, strict=True)
        for joint, angle, (low, high) in series:
            yield from _large_angle(channel, joint, angle, low, high)
            yield from _outside_limits(channel, joint, angle, low, high)


def _unknown_limits(log: MotorLog, limits: np.ndarray) -> Iterator[Finding]:
    joints = []
    for joint, ends in zip(log.joint_names, limits, strict=True):
        if np.isnan(ends).any():
            joints.append(joint)
    if not joints:
        return

    message = f"the robot has no limits for {', '.join(joints)}"
    remedy = (
        f"rename the joints in the file, or {IN_MAP} by name; or give the robot that was recorded"
    )
    yield Finding("info", "limits", len(joints), message, remedy)


def _large_angle(
    channel: str, joint: str, angle: np.ndarray, low: float, high: float
) -> Iterator[Finding]:
    """The finding if an angle exceeds one or MAX_TURNS turns, and the known limits."""
    row = int(np.argmax(np.abs(angle)))
    size = abs(float(angle[row]))
    travel = float(np.ptp(angle))
    reach = float(np.nanmax(np.abs([0.0, low, high])))
    message = (
        f"{channel}/{joint} is {angle[row]:.4g} rad in row {row}, it moves over {travel:.4g} rad"
    )
    if size > max(MAX_TURNS * math.tau, reach):
        message += f"; beyond {max(MAX_TURNS, reach / math.tau):.3g} turns"
        remedy = (
            f"if it is one row, delete it; else {_UNITS}; or give the robot, if its limits are so "
            "wide"
        )
        yield Finding("error", "units", size, message, remedy, joint, row)
    elif size > max(math.tau, reach) or travel > np.nanmax([math.tau, high - low]):
        message += ": more than one turn"
        remedy = (
            f"if these are not rad, {_UNITS}; if the encoder wrapped, state wraps = true for it "
            "in the map"
        )
        yield Finding("warning", "units", size, message, remedy, joint, row)


def _outside_limits(
    channel: str, joint: str, angle: np.ndarray, low: float, high: float
) -> Iterator[Finding]:
    row = int(np.argmax(np.maximum(low - angle, angle - high)))
    if angle[row] < low or angle[row] > high:
        message = (
            f"{channel}/{joint} is {angle[row]:.4g} rad in row {row}, outside {low:.4g} to "
            f"{high:.4g} rad"
        )
        remedy = (
            f"check the encoder's zero, sign and joint order; correct them in the file, or {IN_MAP}"
        )
        yield Finding("warning", "limits", float(angle[row]), message, remedy, joint, row)


def speeds(log: MotorLog) -> Iterator[Finding]:
    """Speeds above 100 rad/s of joint_pos or joint_vel.

    The speed of joint_pos counts if it lasts for two steps, so that jumps and ends of segments do
    not count. Single fast readings of joint_vel count as failed reads.
    """
    yield from _speeds_of_angles(log)
    if log.joint_vel is None:
        return
    failed = velocity_spikes(log.joint_vel)
    series = zip(log.joint_names, failed.T, np.abs(log.joint_vel).T, strict=True)
    for joint, is_spike, speed in series:
        yield from _spikes_of_speed(joint, is_spike, speed)
        yield from _fast_readings(joint, is_spike, speed)


def _speeds_of_angles(log: MotorLog) -> Iterator[Finding]:
    # steps over 10 ms: over a single row, an encoder step would look fast
    width = max(1, round(0.01 / log.period))
    rows = np.arange(0, log.num_rows, width)
    velocity = np.diff(log.joint_pos[rows], axis=0)
    velocity /= np.maximum(np.diff(log.time[rows]), width * log.period)[:, None]

    slower_step = np.minimum(np.abs(velocity[1:]), np.abs(velocity[:-1]))
    is_same_direction = velocity[1:] * velocity[:-1] > 0.0
    lasting = slower_step * is_same_direction
    for column, joint in enumerate(log.joint_names):
        fast_rows = rows[np.flatnonzero(lasting[:, column] > MAX_SPEED)]
        if len(fast_rows) > 5:
            fastest = float(lasting[:, column].max())
            message = (
                f"joint_pos/{joint} moves at up to {fastest:.4g} rad/s, faster than "
                f"{MAX_SPEED:g} rad/s"
            )
            yield Finding("error", "units", fastest, message, _UNITS, joint, int(fast_rows[0]))


def _spikes_of_speed(joint: str, is_spike: np.ndarray, speed: np.ndarray) -> Iterator[Finding]:
    if is_spike.any():
        count = is_spike.sum()
        message = (
            f"joint_vel/{joint}: {count} single readings of up to {speed[is_spike].max():.4g} rad/s"
        )
        remedy = f"{LEFT_OUT}; or leave joint_vel out"
        row = int(is_spike.argmax())
        yield Finding("warning", "failed_reads", float(count), message, remedy, joint, row)


def _fast_readings(joint: str, is_spike: np.ndarray, speed: np.ndarray) -> Iterator[Finding]:
    is_fast = (speed > MAX_SPEED) & ~is_spike
    if is_fast.any():
        fastest = float(speed[is_fast].max())
        message = (
            f"joint_vel/{joint} is up to {fastest:.4g} rad/s, above {MAX_SPEED:g} rad/s in "
            f"{100 * is_fast.mean():.2g} % of the rows"
        )
        remedy = f'leave joint_vel out, or state its unit {IN_MAP}: velocity = "deg/s" or "rpm"'
        severity = "error" if is_fast.mean() > 0.02 else "warning"  # failed reads are rare
        row = int(is_fast.argmax())
        yield Finding(severity, "units", fastest, message, remedy, joint, row)


def summary(log: MotorLog) -> Iterator[Finding]:
    """Facts for comparison with the robot: angles in degrees, logged gains and registers."""
    degrees = np.rad2deg([log.joint_pos.min(axis=0), log.joint_pos.max(axis=0)])
    ranges = [
        f"{joint} {low:.4g}..{high:.4g}"
        for joint, (low, high) in zip(log.joint_names, degrees.T, strict=True)
    ]
    largest = float(np.abs(degrees).max())
    yield Finding("info", "angles", largest, f"angles in degrees: {', '.join(ranges)}")

    settings = settings_text(log) or "no gain, register or posture"
    yield Finding("info", "settings", 0.0, f"the log states {settings}")


CHECKS = (rate, gaps, repeats, interpolated, speeds, summary)
