"""Checks of readings: rate, gaps, repeated rows, jumps, and units that make angles and speeds implausible."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog, settings_text, time_steps
from motorprior.logs.operations import GAP_FACTOR, gap_rows, repeated_rows
from motorprior.robots.robot import Robot
from motorprior.signals import encoder_step

RATES = (5.0, 2e4)  # plausible rates of motor logs [Hz]; others mean another unit of time
MAX_JITTER = 0.5
MAX_FAILED = 5  # maximum length of a failed read [readings]
MAX_LAG = 0.25  # maximum lag of a servo behind its command [s]
MAX_TURNS = 4.0  # maximum angle of a joint without known limits [turns]
MAX_SPEED = 100.0  # no geared joint is so fast [rad/s]
# kinds of jumps
FAILED = "and back (failed read)"
STAYS = "and stays"
WRAPS = "by a turn"
LEFT_OUT = "check the bus; mp.load_log and `motorprior logs import` leave these rows out"
_UNITS = f'convert them in the file, or state their unit {IN_MAP}: angle = "deg", "turn" or "tick"'
REMEDIES = {
    WRAPS: f"state wraps = true for the joint {IN_MAP}; or unwrap angle and command in the file by "
    "numpy.unwrap(column, period=one turn in the column's unit: 4096 for such ticks, 360 for degrees, 2π for rad)",
    FAILED: f"{LEFT_OUT}; or delete these rows from the file",
    STAYS: f"check bus, power and homing; delete the wrong rows, or begin a segment there {IN_MAP} by segment",
}


def rate(log: MotorLog) -> Iterator[Finding]:
    """Rate [Hz], 1 / median time step, and jitter, (95th - 5th percentile of the time steps) / median."""
    rows, steps = time_steps(log)
    median = float(np.median(steps))
    hertz, (lowest, highest) = 1.0 / median, RATES
    jitter = float(np.subtract(*np.percentile(steps, [95, 5]))) / median
    message = (
        f"median time step {1e3 * median:.3g} ms ({hertz:.4g} Hz), jitter {jitter:.2f} of the step"
    )
    if not 0.99 * lowest <= hertz <= 1.01 * highest:
        message += f"; outside {lowest:g} to {highest:g} Hz"
        remedy = f'convert the time in the file, or state its unit {IN_MAP}: time = "s", "ms", "us" or "ns"'
        yield Finding("error", "rate", hertz, message, f"{remedy}; or record faster")
        return
    yield Finding("info", "rate", hertz, message)
    if jitter > MAX_JITTER:
        row = int(rows[np.argmax(np.abs(steps - median) > 0.5 * MAX_JITTER * median)])
        remedy = f"import with a period; if these are times of arrival, record the robot's or state rate = … {IN_MAP}"
        yield Finding(
            "warning", "jitter", jitter, f"{message}, more than {MAX_JITTER}", remedy, row=row
        )


def gaps(log: MotorLog) -> Iterator[Finding]:
    """Time steps above 5 medians of their segment."""
    rows = gap_rows(log)
    if rows.size:
        steps = log.time[rows] - log.time[rows - 1]
        message = f"{len(rows)} gaps longer than {GAP_FACTOR:g} median steps, the longest {1e3 * steps.max():.3g} ms"
        remedy = "find out why rows are lost; mp.load_log and `motorprior logs import` begin a segment after each gap"
        yield Finding("warning", "gaps", float(steps.max()), message, remedy, row=int(rows[0]))


def repeats(log: MotorLog) -> Iterator[Finding]:
    """Angles that repeat in fast motion: all joints (rows without new readings), or one joint (joints read in turn).

    Slow motion does not count: below an encoder step per row, angles repeat in any log.
    """
    whole = repeated_rows(log)
    moved = [_displacements(angle) for angle in log.joint_pos.T]
    cases = [(None, whole, np.max(moved, axis=0), 0.05)]
    cases += [
        (joint, repeated_rows(log.joint(column)) & ~whole, moved[column], 0.4)
        for column, joint in enumerate(log.joint_names)
    ]
    for joint, repeated, travel, bound in cases:
        fast = travel >= np.percentile(travel[travel > 0.0], 75) if travel.any() else travel > 0.0
        if fast.sum() < 20 or min(share := float(repeated[fast].mean()), repeated.mean()) <= bound:
            continue
        fresh = log.rows(~repeated).period
        message = f"{100 * share:.3g} % of the rows repeat the angle of {joint or 'all joints'} in fast motion (bound "
        message += f"{100 * bound:g} %): new readings every {1e3 * fresh:.3g} ms, rows every {1e3 * log.period:.3g} ms"
        remedy = "record one row per new reading of all joints, or import with a period no shorter than theirs"
        yield Finding("warning", "repeats", share, message, remedy, joint, int(np.argmax(repeated)))


def _displacements(angle: np.ndarray) -> np.ndarray:
    """(T,) smaller displacement of a joint in the 5 rows before and after, 0 below 10 encoder steps."""
    travel = np.abs(angle[5:] - angle[:-5])
    moved = np.zeros(len(angle))
    moved[5:-5] = np.minimum(travel[5:], travel[:-5])
    return np.where(moved >= 10.0 * encoder_step(angle), moved, 0.0)


def jumps(log: MotorLog) -> Iterator[Finding]:
    """Errors: failed reads (back within five readings), encoders and commands that wrap (by a turn), lasting jumps."""
    period = _reading_period(log)
    for column, joint in enumerate(log.joint_names):
        rows: dict[tuple[str, str], list[int]] = {}
        for channel, kind, row in _jumps(log, column, period):
            rows.setdefault((channel, kind), []).append(row)
        for (channel, kind), (row, *others) in rows.items():
            before, after = getattr(log, channel)[row - 1 : row + 1, column].tolist()
            message = f"{channel}/{joint} jumps from {before:.4g} to {after:.4g} rad in row {row}, {kind}; "
            message += f"{1 + len(others)} such rows"
            yield Finding("error", "jumps", after - before, message, REMEDIES[kind], joint, row)


def failed_reads(log: MotorLog) -> np.ndarray:
    """(T, J) rows in which a read of a joint failed.

    Its angle jumps and comes back within 5 readings, or jumps within 5 readings of an end of a
    segment; or its velocity is a spike (`velocity_spikes`).
    """
    failed = np.zeros(log.joint_pos.shape, dtype=bool)
    period = _reading_period(log)
    for column in range(log.num_joints):
        for _, kind, row in _jumps(log, column, period):
            part = next(part for part in log.segment_slices() if part.start <= row < part.stop)
            if kind == FAILED:
                failed[row, column] = True
            elif kind == STAYS and row - part.start <= MAX_FAILED:
                failed[part.start : row, column] = True
            elif kind == STAYS and part.stop - row <= MAX_FAILED:
                failed[row : part.stop, column] = True
    return failed if log.joint_vel is None else failed | velocity_spikes(log.joint_vel)


def velocity_spikes(velocity: np.ndarray) -> np.ndarray:
    """(T, J) readings above MAX_SPEED, and above five times the median of the 11 readings around them.

    A joint that moves so fast, or in another unit, is as fast before and after.
    """
    speed = np.abs(velocity)
    around = 2 * MAX_FAILED + 1
    padded = np.pad(
        speed, ((MAX_FAILED, MAX_FAILED), (0, 0)), "reflect" if len(speed) > MAX_FAILED else "edge"
    )
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, around, axis=0), axis=-1)
    return (speed > MAX_SPEED) & (speed > 5.0 * usual)


def _reading_period(log: MotorLog) -> float:
    """Period of new readings [s]: a host may poll faster than the robot answers."""
    steps = time_steps(log.rows(~repeated_rows(log)))[1]
    return min(5.0 * log.period, float(np.median(steps))) if steps.size else log.period


def _jumps(log: MotorLog, column: int, period: float) -> Iterator[tuple[str, str, int]]:
    """Channel, kind and row of each jump of one joint; ``period`` of new readings [s].

    A jump exceeds 3·u, 10 encoder steps, 10 rad/s and 0.03 rad, with u = sixth largest
    |median(Δ[k-1], Δ[k], Δ[k+1])| over the steps Δ: fast motion increases u, a failed read does
    not. `_spikes` also finds single readings that jump and come back during slow motion.
    """
    angle = log.joint_pos[:, column]
    command = log.position_target[:, column]
    steps, command_steps = (np.diff(values, prepend=values[0]) for values in (angle, command))
    for part in log.segment_slices():
        steps[part.start] = command_steps[part.start] = 0.0
    if np.ptp(angle) <= 0.5 * math.tau:
        for row in np.flatnonzero(np.abs(np.abs(command_steps) - math.tau) < 0.3).tolist():
            yield "position_target", WRAPS, row
    rows = np.flatnonzero(steps)
    steps = steps[rows]
    moves = np.pad(steps - math.tau * np.rint(steps / math.tau), 1)
    medians = np.median([moves[:-2], moves[1:-1], moves[2:]], axis=0)
    usual = float(np.sort(np.append(np.zeros(6), np.abs(medians)))[-6])
    min_jump = max(min(10.0 * encoder_step(angle), 0.3), 10.0 * period, 0.03)
    spikes = set(_spikes(angle, log.segment_slices(), min_jump))
    yield from (("joint_pos", FAILED, row) for row in sorted(spikes))
    bound = max(3.0 * usual, min_jump)
    lag = 1 + int(MAX_LAG / log.period)
    places = np.flatnonzero(np.abs(steps) > bound)[:10_000]
    back = 0
    for number, place in enumerate(places.tolist()):
        row = int(rows[place])
        size = abs(float(steps[place]))
        later = places[number + 1 : number + 1 + MAX_FAILED]
        near = np.abs(angle[rows[later]] - angle[row - 1]) <= np.maximum(
            0.25 * size, usual * (later - place + 1)
        )
        waited = log.time[rows[later]] - log.time[row]
        near &= (waited >= 0.0) & (waited <= 1.01 * MAX_FAILED * period)
        speed = size / max(period, float(log.time[row] - log.time[row - 1]))
        beside = np.delete(np.arange(max(0, place - 3), min(len(steps), place + 4)), min(place, 3))
        # An angle that is held has no steps.
        beside = beside[np.abs(log.time[rows[beside]] - log.time[row]) <= 3.5 * period]
        neighbours = np.abs(steps[beside])
        if row < back or {row, row - 1} & spikes:
            continue
        if abs(size - math.tau) <= bound:
            yield "joint_pos", WRAPS, row
        elif np.abs(command_steps[max(1, row - lag + 1) : row + 1]).max(initial=0.0) >= 0.5 * size:
            continue  # the command stepped, too
        elif near.any():
            back = int(rows[later[np.argmax(near)]])
            yield from (("joint_pos", FAILED, each) for each in range(row, back))
        elif (
            speed > 50.0 and neighbours.max(initial=0.0) <= 0.125 * size
        ):  # a joint would accelerate over several rows
            yield "joint_pos", STAYS, row


def _spikes(angle: np.ndarray, parts: Sequence[slice], min_jump: float) -> Iterator[int]:
    """Rows of single readings that jump and come back.

    Both steps exceed ``min_jump`` [rad], and 8 times the motion around them: the steps before and
    after, and their sum.
    """
    for part in parts:
        steps = np.diff(angle[part])
        if len(steps) < 4:
            continue
        out = steps[1:-2]
        back = steps[2:-1]
        around = np.max(np.abs([steps[:-3], out + back, steps[3:]]), axis=0)
        is_spike = (out * back < 0.0) & (
            np.minimum(np.abs(out), np.abs(back)) > np.maximum(min_jump, 8.0 * around)
        )
        yield from (part.start + 2 + np.flatnonzero(is_spike)).tolist()


def angle_limits(log: MotorLog, robot: Robot | None = None) -> Iterator[Finding]:
    """Angles outside the limits of the robot, or beyond one turn (warning) or four turns (error) without limits."""
    limits = (
        np.full((log.num_joints, 2), np.nan) if robot is None else robot.limits_of(log.joint_names)
    )
    unknown = [
        joint for joint, bound in zip(log.joint_names, limits, strict=True) if np.isnan(bound).any()
    ]
    if robot is not None and unknown:
        remedy = f"rename the joints in the file, or {IN_MAP} by name; or give the robot that was recorded"
        yield Finding(
            "info",
            "limits",
            len(unknown),
            f"the robot has no limits for {', '.join(unknown)}",
            remedy,
        )
    for channel in ("position_target", "joint_pos"):
        for joint, angle, (low, high) in zip(
            log.joint_names, getattr(log, channel).T, limits, strict=True
        ):
            row = int(np.argmax(np.abs(angle)))
            reach = float(np.nanmax(np.abs([0.0, low, high])))
            size = abs(float(angle[row]))
            moved = float(np.ptp(angle))
            message = f"{channel}/{joint} is {angle[row]:.4g} rad in row {row}, it moves over {moved:.4g} rad"
            if size > max(MAX_TURNS * math.tau, reach):
                message += f"; beyond {max(MAX_TURNS, reach / math.tau):.3g} turns"
                remedy = f"if it is one row, delete it; else {_UNITS}; or give the robot, if its limits are so wide"
                yield Finding("error", "units", size, message, remedy, joint, row)
            elif size > max(math.tau, reach) or moved > np.nanmax([math.tau, high - low]):
                remedy = f"if these are not rad, {_UNITS}; if the encoder wrapped, state wraps = true for it in the map"
                yield Finding(
                    "warning", "units", size, f"{message}: more than one turn", remedy, joint, row
                )
            row = int(np.argmax(np.maximum(low - angle, angle - high)))
            if angle[row] < low or angle[row] > high:
                message = f"{channel}/{joint} is {angle[row]:.4g} rad in row {row}, outside {low:.4g} to {high:.4g} rad"
                remedy = f"check the encoder's zero, sign and joint order; correct them in the file, or {IN_MAP}"
                yield Finding("warning", "limits", float(angle[row]), message, remedy, joint, row)


def speeds(log: MotorLog) -> Iterator[Finding]:
    """Speeds above 100 rad/s of joint_pos or joint_vel; single such readings of joint_vel are failed reads.

    A speed of joint_pos counts if it lasts for two steps, so jumps and segment ends do not count.
    """
    width = max(1, round(0.01 / log.period))  # over a single row an encoder step would look fast
    rows = np.arange(0, log.num_rows, width)
    velocity = np.diff(log.joint_pos[rows], axis=0)
    velocity /= np.maximum(np.diff(log.time[rows]), width * log.period)[:, None]
    lasting = np.minimum(*np.abs([velocity[1:], velocity[:-1]])) * (
        velocity[1:] * velocity[:-1] > 0.0
    )
    for column, joint in enumerate(log.joint_names):
        places = rows[np.flatnonzero(lasting[:, column] > MAX_SPEED)]
        if len(places) > 5:
            fastest = float(lasting[:, column].max())
            message = f"joint_pos/{joint} moves at up to {fastest:.4g} rad/s, faster than {MAX_SPEED:g} rad/s"
            yield Finding("error", "units", fastest, message, _UNITS, joint, int(places[0]))
    if log.joint_vel is None:
        return
    failed = velocity_spikes(log.joint_vel)
    for joint, spikes, speed in zip(
        log.joint_names, failed.T, np.abs(log.joint_vel).T, strict=True
    ):
        if spikes.any():
            message = f"joint_vel/{joint}: {spikes.sum()} single readings of up to {speed[spikes].max():.4g} rad/s"
            remedy = f"{LEFT_OUT}; or leave joint_vel out"
            yield Finding(
                "warning",
                "failed_reads",
                float(spikes.sum()),
                message,
                remedy,
                joint,
                int(spikes.argmax()),
            )
        fast = (speed > MAX_SPEED) & ~spikes
        if fast.any():
            message = f"joint_vel/{joint} is up to {speed[fast].max():.4g} rad/s, above {MAX_SPEED:g} rad/s in "
            message += f"{100 * fast.mean():.2g} % of the rows"
            remedy = f'leave joint_vel out, or state its unit {IN_MAP}: velocity = "deg/s" or "rpm"'
            severity = "error" if fast.mean() > 0.02 else "warning"  # failed reads are rare
            yield Finding(
                severity,
                "units",
                float(speed[fast].max()),
                message,
                remedy,
                joint,
                int(fast.argmax()),
            )


def summary(log: MotorLog) -> Iterator[Finding]:
    """For comparison with the robot (info): ranges of the angles in degrees, and logged gains and registers."""
    degrees = np.rad2deg([log.joint_pos.min(axis=0), log.joint_pos.max(axis=0)])
    spans = [
        f"{joint} {low:.4g}..{high:.4g}"
        for joint, (low, high) in zip(log.joint_names, degrees.T, strict=True)
    ]
    yield Finding(
        "info", "angles", float(np.abs(degrees).max()), f"angles in degrees: {', '.join(spans)}"
    )
    yield Finding(
        "info",
        "settings",
        0.0,
        f"the log states {settings_text(log) or 'no gain, register or posture'}",
    )


CHECKS = (rate, gaps, repeats, speeds, summary)
