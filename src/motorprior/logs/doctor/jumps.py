"""Check for jumps: failed reads, encoder wraps, angles that jump and stay."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog, time_steps
from motorprior.logs.resampling import repeated_rows

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


def encoder_step(angle: np.ndarray) -> float:
    """Smallest difference [rad] above 1e-6 between two readings (T,), 0 if all are equal."""
    steps = np.diff(np.unique(angle[:: max(1, len(angle) // 20_000)]))
    steps = steps[steps > 1e-6]  # below this is rounding
    return float(steps.min()) if steps.size else 0.0


def jumps(log: MotorLog) -> list[Finding]:
    """Errors: failed reads (back within five readings), encoders and commands that wrap (by a turn), lasting jumps."""
    steps = time_steps(log.rows(~repeated_rows(log)))[1]  # a host may poll faster than the robot answers
    period = min(5.0 * log.period, float(np.median(steps))) if steps.size else log.period
    found = []
    for column, joint in enumerate(log.joint_names):
        rows: dict[tuple[str, str], list[int]] = {}
        for channel, kind, row in _jumps(log, column, period):
            rows.setdefault((channel, kind), []).append(row)
        for (channel, kind), (row, *others) in rows.items():
            before, after = getattr(log, channel)[row - 1 : row + 1, column].tolist()
            message = f"{channel}/{joint} jumps from {before:.4g} to {after:.4g} rad in row {row}, {kind}; "
            message += f"{1 + len(others)} such rows"
            found.append(Finding("error", "jumps", after - before, message, REMEDIES[kind], joint, row))
    return found


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
