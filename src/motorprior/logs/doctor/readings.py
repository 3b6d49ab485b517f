"""Checks of the time column and of readings: rate, gaps, repeated rows, jumps."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.operations import GAP_FACTOR, gap_rows, repeated_rows

RATES = (5.0, 2e4)  # of motor logs [Hz]; other rates mean another unit of time
MAX_JITTER = 0.5
READINGS = 5  # maximum duration of a failed read
MAX_LAG = 0.25  # maximum lag of a servo behind its command [s]
TURN = 2.0 * np.pi
_UNWRAP = "unwrap angle and command in the file: numpy.unwrap(column, period=one turn in its unit, such as 4096 ticks)"
REMEDIES = {
    "by a turn": _UNWRAP,
    "by a turn that the angle does not make": _UNWRAP,
    "and back (failed read)": "check the bus; delete these rows from the file",
    "and stays": f"check bus, power and homing; delete the wrong rows, or begin a segment there {IN_MAP} by segment",
}


def rate(log: MotorLog) -> Iterator[Finding]:
    """Rate [Hz], 1 / median time step, and jitter, (95th - 5th percentile of the time steps) / median."""
    rows, steps = time_steps(log)
    median = float(np.median(steps))
    hertz, (lowest, highest) = 1.0 / median, RATES
    jitter = float(np.subtract(*np.percentile(steps, [95, 5]))) / median
    message = f"median time step {1e3 * median:.3g} ms ({hertz:.4g} Hz), jitter {jitter:.2f} of the step"
    if not 0.99 * lowest <= hertz <= 1.01 * highest:
        message += f"; outside {lowest:g} to {highest:g} Hz"
        remedy = f'convert the time in the file, or state its unit {IN_MAP}: time = "s", "ms", "us" or "ns"'
        yield Finding("error", "rate", hertz, message, f"{remedy}; or record faster", row=0)
        return
    yield Finding("info", "rate", hertz, message, row=0)
    if jitter > MAX_JITTER:
        row = int(rows[np.argmax(np.abs(steps - median) > 0.5 * MAX_JITTER * median)])
        message = f"time steps vary by {jitter:.2f} of their median {1e3 * median:.3g} ms, more than {MAX_JITTER}"
        remedy = "import with a period, which resamples the log; if these are times of arrival, record the robot's "
        remedy += f"time, or replace the time by rate = … {IN_MAP}"
        yield Finding("warning", "jitter", jitter, message, remedy, row=row)


def gaps(log: MotorLog) -> Iterator[Finding]:
    """Time steps above 5 medians of their segment."""
    rows = gap_rows(log)
    if rows.size:
        steps = log.time[rows] - log.time[rows - 1]
        longest, first = int(np.argmax(steps)), int(rows[0])
        message = f"{len(rows)} gaps longer than {GAP_FACTOR:g} median steps, the first before row {first}, the longest"
        message += f" {1e3 * steps[longest]:.3g} ms before row {rows[longest]}"
        remedy = "find out why rows are lost; mp.load_log and `motorprior logs import` begin a segment after each gap"
        yield Finding("warning", "gaps", float(steps[longest]), message, remedy, row=first)


def repeats(log: MotorLog) -> Iterator[Finding]:
    """Angles that repeat in fast motion: those of all joints (rows without new readings), or of one (read in turn).

    Static joints, and joints that move slower than an encoder step per row, repeat their angles in any log.
    """
    whole, moved = repeated_rows(log), [_displacements(angle) for angle in log.joint_pos.T]
    for joint in (None, *log.joint_names):
        repeated, way, bound = whole, np.max(moved, axis=0), 0.05
        if joint is not None:
            column = log.joint_names.index(joint)
            repeated, way, bound = repeated_rows(log.joint(column)) & ~whole, moved[column], 0.4
        fast = way >= np.percentile(way[way > 0.0], 75) if way.any() else way > 0.0
        if fast.sum() < 20 or min(share := float(repeated[fast].mean()), repeated.mean()) <= bound:
            continue
        fresh = float(np.median(time_steps(log.rows(~repeated))[1]))
        message = (
            f"{100 * share:.0f} % of the rows repeat the last angle of {joint or 'all joints'} in fast motion (bound "
            f"{100 * bound:g} %): new readings every {1e3 * fresh:.3g} ms, rows every {1e3 * log.period:.3g} ms"
        )
        remedy = "record one row per new reading of all joints, or import with a period no shorter than theirs"
        yield Finding("warning", "repeats", share, message, remedy, joint, int(np.argmax(repeated)))


def _displacements(angle: np.ndarray) -> np.ndarray:
    """(T,) smaller displacement of a joint in the 5 rows before and after, 0 below 10 encoder steps."""
    way, moved = np.abs(angle[5:] - angle[:-5]), np.zeros(len(angle))
    moved[5:-5] = np.minimum(way[5:], way[:-5])
    return np.where(moved >= 10.0 * encoder_step(angle), moved, 0.0)


def encoder_step(angle: np.ndarray) -> float:
    """Smallest difference [rad] above 1e-6 between two readings (T,), 0 if all are equal."""
    steps = np.diff(np.unique(angle[:: max(1, len(angle) // 20_000)]))
    steps = steps[steps > 1e-6]  # below this is rounding
    return float(steps.min()) if steps.size else 0.0


def jumps(log: MotorLog) -> Iterator[Finding]:
    """Errors: failed reads (back within five readings), encoders and commands that wrap (by a turn), lasting jumps."""
    steps = time_steps(log.rows(~repeated_rows(log)))[1]  # a host may poll faster than the robot answers
    period = min(5.0 * log.period, float(np.median(steps))) if steps.size else log.period
    for column, joint in enumerate(log.joint_names):
        rows: dict[tuple[str, str], list[int]] = {}
        for channel, kind, row in _jumps(log, column, period):
            rows.setdefault((channel, kind), []).append(row)
        for (channel, kind), (row, *others) in rows.items():
            before, after = getattr(log, channel)[row - 1 : row + 1, column].tolist()
            message = f"{channel}/{joint} jumps from {before:.4g} to {after:.4g} rad in row {row}, {kind}; "
            message += f"{1 + len(others)} such rows"
            yield Finding("error", "jumps", after - before, message, REMEDIES[kind], joint, row)


def _jumps(log: MotorLog, column: int, period: float) -> Iterator[tuple[str, str, int]]:
    """Channel, kind and row of each jump of one joint; ``period`` of new readings [s].

    A jump exceeds 3 usual steps, 10 encoder steps, 10 rad/s and 0.03 rad. The usual step is the sixth largest median of
    three successive steps, which fast motion raises and a failed read does not.
    """
    angle, command = log.joint_pos[:, column], log.position_target[:, column]
    steps, command_steps = (np.diff(values, prepend=values[0]) for values in (angle, command))
    for part in log.segment_slices():
        steps[part.start] = command_steps[part.start] = 0.0
    if np.ptp(angle) <= 0.5 * TURN:
        for row in np.flatnonzero(np.abs(np.abs(command_steps) - TURN) < 0.3).tolist():
            yield "position_target", "by a turn that the angle does not make", row
    rows = np.flatnonzero(steps)
    steps = steps[rows]
    moves = np.pad(steps - TURN * np.rint(steps / TURN), 1)
    medians = np.median([moves[:-2], moves[1:-1], moves[2:]], axis=0)
    usual = float(np.sort(np.append(np.zeros(6), np.abs(medians)))[-6])
    bound = max(3.0 * usual, min(10.0 * encoder_step(angle), 0.3), 10.0 * period, 0.03)
    lag, places, back = 1 + int(MAX_LAG / log.period), np.flatnonzero(np.abs(steps) > bound)[:10_000], 0
    for number, place in enumerate(places.tolist()):
        row, size = int(rows[place]), abs(float(steps[place]))
        later = places[number + 1 : number + 1 + READINGS]
        near = np.abs(angle[rows[later]] - angle[row - 1]) <= np.maximum(0.25 * size, usual * (later - place + 1))
        waited = log.time[rows[later]] - log.time[row]
        near &= (waited >= 0.0) & (waited <= 1.01 * READINGS * period)
        speed = size / max(period, float(log.time[row] - log.time[row - 1]))
        neighbours = np.abs(np.delete(steps[max(0, place - 3) : place + 4], min(place, 3)))
        if row < back:
            continue
        if abs(size - TURN) <= bound:
            yield "joint_pos", "by a turn", row
        elif np.abs(command_steps[max(1, row - lag + 1) : row + 1]).max(initial=0.0) >= 0.5 * size:
            continue  # the command stepped, too
        elif near.any():
            back = int(rows[later[np.argmax(near)]])
            yield from (("joint_pos", "and back (failed read)", each) for each in range(row, back))
        elif speed > 50.0 and neighbours.max(initial=0.0) <= 0.125 * size:  # a joint would accelerate over several rows
            yield "joint_pos", "and stays", row
