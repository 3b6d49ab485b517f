"""Check for angles that jump as no joint moves: reads that failed, encoders that wrap, readings that leap and stay.

What a joint does is measured by itself. A step from one reading to the next is a jump where it is beyond

    max(3·usual step, 7·noise, 10·encoder step, 10 rad/s · period, 0.03 rad)

The usual step is the sixth largest median of three steps after one another, which fast motion raises and a wrong
reading does not. The noise is the median size of the second differences. Readings that repeat a few times are taken
once, since a host may poll faster than the robot answers. A jump of a turn is one of an encoder that wraps. Others are
failed reads if the angle is back within five readings, and leaps if no joint is so fast; a command that stepped shortly
before excuses them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from motorprior.logs.doctor.command_lag import MAX_LAG
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.doctor.sensor_checks import encoder_step
from motorprior.logs.doctor.unit_checks import HANDFUL
from motorprior.logs.motor_log import MotorLog

USUAL, NOISE, LEVELS = 3.0, 7.0, 10.0
MOST_LEVELS = 0.3
"""[rad]; a joint at rest has few different readings, of which the failed one must not pass for an encoder's step."""
LEAST_JUMP = 0.03
"""[rad]"""
LEAST_SPEED = 10.0
"""Of a jump [rad/s]."""
LEAP_SPEED = 50.0
"""Of one that stays, in one step, beside steps of no more than ALONE of it [rad/s]."""
ALONE = 0.125
BACK = 0.25
"""An angle is back where it was, to this share of the jump."""
REACH = 5
"""Readings after which it is no failed read any more."""
COMMANDED = 0.5
"""A command that stepped by this share of the jump explains it."""
TURN = 2.0 * np.pi
NEAR_TURN = 0.3
"""A command's step is by a turn if it is so close to one [rad]."""
MOST_JUMPS = 10_000
"""Of a joint, that are looked at."""

Kind = Literal["glitch", "turn", "leap"]
_UNWRAP = "unwrap its columns, angle and command alike, before you import them (numpy.unwrap)"
_DELETE = (
    "check the bus; delete these rows from the file: `motorprior logs import` fills short gaps, with a period, and "
    "begins a segment after longer ones"
)
_CUT = (
    "check bus, power and homing; delete the rows that are wrong, split the file there, or begin a segment there by a "
    f"column that segment names {IN_MAP}"
)


@dataclass(frozen=True, eq=False)
class _Readings:
    """The readings of one joint, those left out that repeat the one before for a few rows only; R of them.

    Attributes:
        rows: (R,) where they stand.
        steps: (R,) from the reading before [rad].
        usual: step that the joint makes by moving [rad].
        bound: step beyond which it jumps [rad].
        period: of new readings [s].
        lag: rows that a command may be late.
    """

    rows: np.ndarray
    steps: np.ndarray
    usual: float
    bound: float
    period: float
    lag: int


def jumps(log: MotorLog) -> list[Finding]:
    """Errors: commands that wrap; angles that leave for a few rows, that step by a turn, or that leap and stay."""
    found = [finding for column in range(log.num_joints) for finding in _wrapped_command(log, column)]
    starts = [part.start for part in log.segment_slices()]
    for column in range(log.num_joints):
        readings = _readings(log, column, starts)
        if readings is not None:
            found += _findings(log, column, readings)
    return found


def _wrapped_command(log: MotorLog, column: int) -> list[Finding]:
    """A command that steps by a turn, of a joint whose angle never goes so far."""
    command, angle = log.position_target[:, column], log.joint_pos[:, column]
    steps = np.diff(command, prepend=command[0])
    steps[[part.start for part in log.segment_slices()]] = 0.0
    turns = np.flatnonzero(np.abs(np.abs(steps) - TURN) < NEAR_TURN)
    if not turns.size or np.ptp(angle) > 0.5 * TURN:
        return []
    row, joint = int(turns[0]), log.joint_names[column]
    message = (
        f"position_target/{joint} jumps from {command[row - 1]:.4g} to {command[row]:.4g} rad in row {row}, by a turn "
        f"that the angle does not make; {len(turns)} such steps"
    )
    return [Finding("error", "jumps", float(steps[row]), NEAR_TURN, message, _UNWRAP, joint, row)]


def _readings(log: MotorLog, column: int, starts: list[int]) -> _Readings | None:
    """None where there are too few to say what is usual."""
    angle = log.joint_pos[:, column]
    steps = np.diff(angle, prepend=angle[0])
    steps[starts] = 0.0
    rows = np.flatnonzero((steps != 0.0) | _at_rest(steps))
    if len(rows) < 2 * HANDFUL:
        return None
    steps = steps[rows]
    moves = steps - TURN * np.rint(steps / TURN)  # without wraps
    usual = float(np.partition(np.abs(_of_three(moves)), -HANDFUL - 1)[-HANDFUL - 1])
    noise = float(np.median(np.abs(np.diff(moves))))
    period = float(np.median(np.diff(log.time[rows])))
    levels = min(LEVELS * encoder_step(angle), MOST_LEVELS)
    bound = max(USUAL * usual, NOISE * noise, levels, LEAST_SPEED * period, LEAST_JUMP)
    lag = 1 + int(MAX_LAG / log.period)
    return _Readings(rows, steps, usual, bound, period, lag)


def _of_three(values: np.ndarray) -> np.ndarray:
    """(R - 2,) median of each value but the first and the last, and its two neighbours."""
    before, here, after = values[:-2], values[1:-1], values[2:]
    return np.maximum(np.minimum(before, here), np.minimum(np.maximum(before, here), after))


def _at_rest(steps: np.ndarray) -> np.ndarray:
    """Mask (T,) of rows whose reading has been the same for so long that it is no repeat of an older one."""
    same = steps == 0.0
    resting = same.copy()
    for back in range(1, REACH + 1):
        resting[back:] &= same[:-back]
    return resting


@dataclass
class _Seen:
    """What was found of one kind: where first, the angle before and after, and how many rows."""

    row: int
    before: float
    after: float
    count: int = 0


def _findings(log: MotorLog, column: int, readings: _Readings) -> list[Finding]:
    angle, joint = log.joint_pos[:, column], log.joint_names[column]
    seen: dict[Kind, _Seen] = {}
    for row, kind, count in _jumps(log, column, readings):
        seen.setdefault(kind, _Seen(row, float(angle[row - 1]), float(angle[row]))).count += count
    return [_finding(kind, joint, what, readings.bound) for kind, what in seen.items()]


def _finding(kind: Kind, joint: str, seen: _Seen, bound: float) -> Finding:
    step = seen.after - seen.before
    described = f"joint_pos/{joint} jumps from {seen.before:.4g} to {seen.after:.4g} rad in row {seen.row}"
    if kind == "turn":
        message, remedy = f"{described}, by a turn; {seen.count} such steps", _UNWRAP
    elif kind == "glitch":
        message, remedy = f"{described} and soon back, as no joint moves; {seen.count} such rows", _DELETE
    else:
        message, remedy = f"{described}, not back soon, as no joint moves; {seen.count} such steps", _CUT
    return Finding("error", "jumps", step, bound, message, remedy, joint, seen.row)


def _jumps(log: MotorLog, column: int, readings: _Readings) -> Iterator[tuple[int, Kind, int]]:
    """First row, kind and number of rows of each jump, in order."""
    rows, places = readings.rows, np.flatnonzero(np.abs(readings.steps) > readings.bound)[:MOST_JUMPS]
    after = 0
    for here, place in enumerate(places.tolist()):
        row, step = int(rows[place]), float(readings.steps[place])
        if row < after:
            continue
        if abs(abs(step) - TURN) <= readings.bound:
            yield row, "turn", 1
        elif _commanded(log, column, row, step, readings.lag):
            continue
        elif (back := _back(log, column, readings, places[here : here + REACH + 1])) is not None:
            after = back + 1
            yield row, "glitch", back - row
        elif _is_leap(log, readings, place):
            yield row, "leap", 1


def _commanded(log: MotorLog, column: int, row: int, step: float, lag: int) -> bool:
    """Whether the command stepped in the ``lag`` rows before by as much as explains a step of the angle."""
    command = log.position_target[max(0, row - lag) : row + 1, column]
    return bool(np.abs(np.diff(command)).max(initial=0.0) >= COMMANDED * abs(step))


def _back(log: MotorLog, column: int, readings: _Readings, places: np.ndarray) -> int | None:
    """Row at which the angle is back where it was before the first of these jumps, by another of them; or None."""
    angle, rows = log.joint_pos[:, column], readings.rows[places]
    step, before = abs(float(readings.steps[places[0]])), angle[rows[0] - 1]
    for place, row in zip(places[1:], rows[1:], strict=True):
        moved = readings.usual * float(place - places[0] + 1)
        waited = log.time[row] - log.time[rows[0]]
        if not 0.0 <= waited <= 1.01 * REACH * readings.period:
            break
        if abs(angle[row] - before) <= max(BACK * step, moved):
            return int(row)
    return None


def _is_leap(log: MotorLog, readings: _Readings, place: int) -> bool:
    """Whether a step is too fast for a joint, which speeds up before and slows down after."""
    step = abs(float(readings.steps[place]))
    row = readings.rows[place]
    speed = step / max(readings.period, float(log.time[row] - log.time[row - 1]))
    around = np.abs(np.delete(readings.steps[max(0, place - 3) : place + 4], min(place, 3)))
    return speed > LEAP_SPEED and float(around.max(initial=0.0)) <= ALONE * step
