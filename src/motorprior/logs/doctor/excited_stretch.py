"""The parts of a log on which costly checks of a joint look: on a uniform grid, and where its command moves most."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from motorprior.logs.doctor.joint_checks import EXCITED_STD, excited_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.resampling import repeated_rows, resample

MAX_SAMPLES = 20_000
MIN_SAMPLES = 20
MANY = 6
"""Most parts of a joint."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """One joint of a part of a log, on a uniform grid of N samples.

    Attributes:
        joint: its name.
        command: (N,) position target [rad].
        angle: (N,) [rad].
        torque: (N,) [N·m], or None.
        period: of the grid [s].
        row: of the whole log at which the part begins.
    """

    joint: str
    command: np.ndarray
    angle: np.ndarray
    torque: np.ndarray | None
    period: float
    row: int


@dataclass(frozen=True)
class _Part:
    """Rows of a log that stretches are made of, and the period of their new readings [s]."""

    start: int
    stop: int
    period: float


def excited_stretches(log: MotorLog) -> dict[str, list[Stretch]]:
    """Of every excited joint the MANY parts in which its command goes the longest way, that with the longest first.

    A part is of one segment and has MAX_SAMPLES at most. A joint is left out where all parts in which it moves are too
    short to say anything.
    """
    moved: dict[int, list[tuple[float, _Part]]] = {}
    columns = excited_joints(log)
    for part in _parts(log):
        command = log.position_target[part.start : part.stop]
        moves, way = np.std(command, axis=0) > EXCITED_STD, np.abs(np.diff(command, axis=0)).sum(axis=0)
        for column in columns[moves[columns]]:
            best = [*moved.get(column, []), (float(way[column]), part)]
            moved[column] = sorted(best, key=lambda pair: -pair[0])[:MANY]

    @cache
    def on_grid(part: _Part) -> MotorLog:
        return resample(log.rows(slice(part.start, part.stop)), part.period)

    return {
        log.joint_names[column]: [_stretch(on_grid(part), column, part) for _, part in parts]
        for column, parts in sorted(moved.items())
    }


def _stretch(log: MotorLog, column: int, part: _Part) -> Stretch:
    """One joint of a part's log."""
    torque = None if log.joint_torque is None else log.joint_torque[:, column]
    command, angle = log.position_target[:, column], log.joint_pos[:, column]
    return Stretch(log.joint_names[column], command, angle, torque, part.period, part.start)


def _parts(log: MotorLog) -> Iterator[_Part]:
    """All parts of the segments that are long enough, and short enough to be put on a grid."""
    for part in log.segment_slices():
        segment = log.rows(part)
        steps = np.diff(segment.rows(~repeated_rows(segment)).time)
        period = float(np.median(steps)) if steps.size else 0.0
        if period <= 0.0 or segment.duration < MIN_SAMPLES * period:
            continue
        rows = max(2, round(MAX_SAMPLES * period / segment.period))
        for start in range(part.start, part.stop, rows):
            stop = min(start + rows, part.stop)
            if MIN_SAMPLES * period <= log.time[stop - 1] - log.time[start] <= 2.0 * MAX_SAMPLES * period:
                yield _Part(start, stop, period)
