"""Checks for what stops where it should go on: saturation at a limit, and channels that die on the way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.logs.doctor.command_lag import MAX_LAG
from motorprior.logs.doctor.findings import Finding
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.doctor.sensor_checks import encoder_step
from motorprior.logs.mask_runs import Runs, runs_of, unchanged_runs
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog
from motorprior.signals import rms

SATURATED_TIME = 0.1
"""A shorter stay at an extreme is the turn of a motion [s]."""
SATURATED_ROWS = 5
TRAVEL = 0.1
"""The command goes on if it moves by this share of its range."""
SAME = 0.02
"""Velocities this close to their extreme, relative, are at it."""
MANY_LEVELS = 20
"""A channel of fewer different values stays at its extreme by chance."""
FAR_BEHIND = 2.5
"""An angle at a limit is behind its command by this many times the error of other rows; in a dead band it is not."""
STICKS = 0.03
"""Friction may hold a joint while its command goes on so far [rad]."""
VISITS = 3
"""A joint meets its end stop so often, or that may be chance."""
LONGEST_LAG = 0.1
"""Longest lag that counts at a stop [s]: a longer one is that of a slow motion with dead band or friction, which stops
where its command turns."""
FLAT = 5.0
"""An end stop has this many times the rows of the two encoder steps before it; a turn has fewer."""
DEAD_TIME = 0.5
DEAD_TRAVEL = 0.5
"""The command moves by this share of its range while a dead channel stays the same."""
DEAD_LEAST = 0.1
"""Less of a command may be lost in the dead zone of a servo [rad]."""
ALIVE = 0.05
"""An angle that moves by this share of its range has a velocity."""


def saturation(log: MotorLog, lags: Mapping[str, float]) -> list[Finding]:
    """Angle, velocity or torque at its extreme for 0.1 s while the command goes on.

    An angle: it has moved there, the command beyond it moves by 10 % of its range, and no dead band or friction at a
    turn explains that: the command is 2.5 times as far away as in other rows (root mean square), or see `_at_a_stop`.
    A velocity: the angle is behind its command by more than 0.25 s of that velocity. A torque: the command moves by
    10 % of its range, and the torque takes many values.

    Args:
        log: the log.
        lags: by which joints follow their commands [s]; 0 of those that are not named.
    """
    found = []
    for column in excited_joints(log):
        for sign in (1.0, -1.0):
            for channel, runs, extreme in _at_extremes(log, column, sign, lags.get(log.joint_names[column], 0.0)):
                if runs.starts.size:
                    found.append(_saturated(log, channel, column, sign * extreme, runs))
    return found


def _at_extremes(log: MotorLog, column: int, sign: float, lag: float) -> list[tuple[str, Runs, float]]:
    """Per channel: long runs at the highest of sign·values while the command goes on, and that highest value."""
    command, angle = sign * log.position_target[:, column], sign * log.joint_pos[:, column]
    travel = TRAVEL * float(np.ptp(command))
    found = [("joint_pos", _at_a_stop(log, command, angle, lag), float(angle.max()))]
    if log.joint_vel is not None and (top_speed := float((speed := sign * log.joint_vel[:, column]).max())) > 0.0:
        behind = command - angle > MAX_LAG * top_speed
        found.append(("joint_vel", _long_runs(log, (speed >= (1.0 - SAME) * top_speed) & behind), top_speed))
    if log.joint_torque is not None and np.ptp(torque := sign * log.joint_torque[:, column]) > 0.0:
        limit = float(torque.max())
        held = _long_runs(log, torque >= limit - 1e-9 * abs(limit))
        many = len(np.unique(torque)) >= MANY_LEVELS
        goes_on = many & (held.highest(command) - held.lowest(command) > travel)
        found.append(("joint_torque", held.where(goes_on), limit))
    return found


def _long_runs(log: MotorLog, mask: np.ndarray) -> Runs:
    runs = runs_of(log, mask)
    return runs.where((runs.durations(log) >= SATURATED_TIME) & (runs.stops - runs.starts >= SATURATED_ROWS))


def _at_a_stop(log: MotorLog, command: np.ndarray, angle: np.ndarray, lag: float) -> Runs:
    """Long runs at the highest of angles (T,) that only an end stop explains.

    The joint came there, and its command moves beyond by 10 % of its range. Either the command is far away; or, as in
    the fast part of a chirp every angle is far from its command, the joint stops so three times or more. Then it is
    much longer at its extreme than just before it. And the command of ``lag`` [s]
    before, to which the joint answers, still rises by 10 % of its range and 0.03 rad after the joint has stopped; where
    friction or a weight stops it, the command has done so first.
    """
    top, travel, step = float(angle.max()), TRAVEL * float(np.ptp(command)), encoder_step(angle)
    at_top = angle >= top - step
    stuck = _long_runs(log, at_top)
    beyond = stuck.highest(command) - np.maximum(stuck.lowest(command), top)
    stuck = stuck.where((beyond > travel) & ~np.isin(stuck.starts, _first_rows(log)))
    free = ~at_top & (angle > angle.min() + step)
    far = stuck.highest(command) - top > FAR_BEHIND * (float(rms((command - angle)[free])) if free.any() else 0.0)
    met = _way_on(log, stuck, np.maximum(command, top), min(lag, LONGEST_LAG)) > max(STICKS, travel)
    again = met.sum() >= VISITS and at_top.sum() > FLAT * np.sum(~at_top & (angle >= top - 3.0 * step))
    return stuck.where(far | (met & again))


def _way_on(log: MotorLog, runs: Runs, command: np.ndarray, lag: float) -> np.ndarray:
    """(R,) how far a command (T,) that acts ``lag`` [s] later rises from the first row of each run [rad]."""
    late, first = _rows_of(log, lag), _first_rows(log)
    starts = np.maximum(runs.starts - late, first[np.searchsorted(first, runs.starts, side="right") - 1])
    return Runs(starts, np.maximum(starts + 1, runs.stops - late)).highest(command) - command[starts]


def _first_rows(log: MotorLog) -> np.ndarray:
    return np.array([part.start for part in log.segment_slices()])


def _saturated(log: MotorLog, channel: str, column: int, extreme: float, runs: Runs) -> Finding:
    joint, time, row = log.joint_names[column], float(runs.durations(log).sum()), int(runs.starts[0])
    message = (
        f"{channel}/{joint} stays at its extreme {extreme:.4g} {JOINT_SERIES[channel]} for {time:.2f} s in all while "
        f"its command goes on, first in row {row}"
    )
    remedy = "if the limit itself is to be learned, keep them; else command less, or delete these rows from the file"
    return Finding("warning", "saturation", time, SATURATED_TIME, message, remedy, joint, row)


def dead(log: MotorLog) -> list[Finding]:
    """Channels that change, but at one time not for 0.5 s in which the command moves by half of its range and 0.1 rad.

    What the command does in the last 0.25 s of such a time does not count: a servo answers late. A velocity is dead
    only while its angle moves; an angle at its extreme is saturated.
    """
    found = []
    for column in excited_joints(log):
        for channel in ("joint_pos", "joint_vel", "joint_torque"):
            values = getattr(log, channel)
            if values is not None and np.ptp(values[:, column]) > 0.0:
                found += _dead_channel(log, channel, column, values[:, column])
    return found


def _dead_channel(log: MotorLog, channel: str, column: int, values: np.ndarray) -> list[Finding]:
    command, angle, joint = log.position_target[:, column], log.joint_pos[:, column], log.joint_names[column]
    runs = unchanged_runs(log, values)
    runs = runs.where(runs.durations(log) >= DEAD_TIME)
    early = Runs(runs.starts, np.maximum(runs.starts + 1, runs.stops - _rows_of(log, MAX_LAG)))
    dead_now = early.highest(command) - early.lowest(command) > max(DEAD_LEAST, DEAD_TRAVEL * float(np.ptp(command)))
    if channel == "joint_vel":
        dead_now &= runs.highest(angle) - runs.lowest(angle) > ALIVE * np.ptp(angle)
    else:
        held = values[runs.starts]
        dead_now &= (held > values.min()) & (held < values.max())
    runs = runs.where(dead_now)
    if not runs.starts.size:
        return []
    time, row = float(runs.durations(log).max()), int(runs.starts[0])
    message = (
        f"{channel}/{joint} does not change for up to {time:.2f} s in which its command moves by more than "
        f"{100 * DEAD_TRAVEL:g} % of its range, first in row {row}"
    )
    remedy = "check the sensor, the power and the bus; record again, or delete these rows from the file"
    return [Finding("warning", "dead", time, DEAD_TIME, message, remedy, joint, row)]


def _rows_of(log: MotorLog, duration: float) -> int:
    return round(duration / log.period)
