"""Splits logs into what models are fitted to and what they are judged by: stretches that never overlap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.doctor.excitation import EXCITED_STD, excited_joints
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog, channels

MOST_LOGS = 16
"""Of more, so many are taken, from all over the list."""
SHORTEST = 1.5
"""Of a segment [s]: a free run of a second and what goes before it; shorter ones are left out."""
LEAST = 2.0
"""Of every log [s], however many there are."""
PIECE = 2.5
"""Of pieces that take turns in being known and judged [s]."""


@dataclass(frozen=True)
class Split:
    """Logs in two.

    Attributes:
        known: by name, to fit to.
        judged: by name, for free runs.
        told: the rule, for the user.
    """

    known: dict[str, MotorLog]
    judged: dict[str, MotorLog]
    told: str

    def map(self, change: Callable[[MotorLog], MotorLog]) -> Split:
        """The same with every log changed."""
        known, judged = ({name: change(log) for name, log in logs.items()} for logs in (self.known, self.judged))
        return Split(known, judged, self.told)


def stretches(logs: Sequence[MotorLog], seconds: float) -> MotorLog:
    """An equal stretch of every log, each from another part of it, ``seconds`` altogether.

    Logs of the same motion are so covered from beginning to end; one that is shorter is used whole.
    """
    return joined([_stretch(log, seconds, index, len(logs)) for index, log in enumerate(logs)])


def _stretch(log: MotorLog, seconds: float, index: int, count: int) -> MotorLog:
    """Of ``count`` logs that share ``seconds``, the stretch of the one with this ``index``."""
    rows = min(log.num_rows, round(seconds / count / log.period))
    first = round((log.num_rows - rows) * index / max(1, count - 1))
    return log.rows(slice(first, first + rows))


def split(logs: Mapping[str, MotorLog], known_seconds: float, judged_seconds: float) -> Split:
    """Every second log against the others, or first halves against second halves, or pieces that take turns.

    Halves where there is one log only, or where a joint moved in judged logs that did not in known ones; pieces where
    other joints move in one half than in the other, as where they are moved one after the other. What stands still at
    the ends of a log is not taken, unless too little else is left.

    Args:
        logs: of the same joints, in which some move.
        known_seconds: of log to fit to, altogether, but at least LEAST of each.
        judged_seconds: of log to judge by, the same.

    Raises:
        LogError: no segment is as long as SHORTEST, or no joint moves in what is known and in what is judged.
    """
    names = list(logs)
    names = [names[round(place)] for place in np.linspace(0, len(names) - 1, min(len(names), MOST_LOGS))]
    taken = {name: awake(logs[name]) for name in names}
    taken = {name: log if log.duration >= 2.0 * LEAST else logs[name] for name, log in taken.items()}
    known, judged = ({name: taken[name] for name in names[first::2]} for first in (0, 1))
    told = f"known: {', '.join(known)}; judged: {', '.join(judged)}"
    if judged:
        known, judged = _cut(known, known_seconds), _cut(judged, judged_seconds)
    if not judged or not set() < _excited(judged) <= _excited(known):
        halves = {name: _halves(log) for name, log in taken.items()}
        known, judged = ({name: both[half] for name, both in halves.items()} for half in (0, 1))
        known, judged = _cut(known, known_seconds), _cut(judged, judged_seconds)
        told = f"known: first half of {', '.join(names)}; judged: second half"
    if not _excited(judged) or _excited(judged) != _excited(known):
        known, judged = _in_turns(taken, known_seconds, judged_seconds)
        told = f"known and judged in turns: pieces of {PIECE:g} s of {', '.join(names)}"
    if len(names) < len(logs):
        told = f"{len(names)} of {len(logs)} logs. {told}"
    return Split(known, judged, told)


def awake(log: MotorLog) -> MotorLog:
    """From the row before the first change of a command to the row after the last; the whole log if there is none."""
    changed = [np.abs(log.position_target - log.position_target[row]).max(axis=1) > EXCITED_STD for row in (0, -1)]
    if not changed[0].any():
        return log
    first, after = int(changed[0].argmax()), log.num_rows - int(changed[1][::-1].argmax())
    return log.rows(slice(max(0, first - 1), after + 1))


def _halves(log: MotorLog) -> tuple[MotorLog, MotorLog]:
    middle = log.num_rows // 2
    return log.rows(slice(0, middle)), log.rows(slice(middle, log.num_rows))


def _excited(logs: Mapping[str, MotorLog]) -> set[int]:
    return {int(joint) for log in logs.values() for joint in excited_joints(log)}


def _cut(logs: Mapping[str, MotorLog], seconds: float) -> dict[str, MotorLog]:
    found = {
        name: long_segments(_stretch(log, max(seconds, LEAST * len(logs)), index, len(logs)))
        for index, (name, log) in enumerate(logs.items())
    }  # fmt: skip
    if kept := {name: log for name, log in found.items() if log is not None}:
        return kept
    where = next(iter(logs.values())).source
    raise LogError(f"no segment of {SHORTEST:g} s", where=where, remedy="give longer recordings")


def _in_turns(
    logs: Mapping[str, MotorLog], known_seconds: float, judged_seconds: float
) -> tuple[dict[str, MotorLog], dict[str, MotorLog]]:
    """Known and judged pieces of logs, as many of each in which a joint moves, from all over the logs.

    Raises:
        LogError: no segment is as long as SHORTEST, or no joint moves in pieces of both.
    """
    pieces = [(name, piece) for name, log in logs.items() for piece in _pieces(log)]
    first = next(iter(logs.values()))
    if not pieces:
        raise LogError(f"no segment of {SHORTEST:g} s", where=first.source, remedy="give longer recordings")
    counts, sides = np.zeros((2, first.num_joints), dtype=int), ([], [])
    for name, piece in pieces:
        moving = excited_joints(piece)
        side = int(counts[0, moving].sum() > counts[1, moving].sum())
        counts[side, moving] += moving.size > 0
        if moving.size:
            sides[side].append((name, piece))
    if not counts.all(axis=0).any():
        where = "; ".join(_where(logs, joint) for joint in moving_joints(logs))
        problem = f"no joint moves in two pieces of {SHORTEST:g} s, one to fit to and one to judge by: {where}"
        raise LogError(problem, where=first.source, remedy="move every joint for 5 s or more")
    return _spread(sides[0], known_seconds), _spread(sides[1], judged_seconds)


def _pieces(log: MotorLog) -> list[MotorLog]:
    """Of each segment, of about PIECE but not below SHORTEST."""
    found = []
    for part in log.segment_slices():
        seconds = float(log.time[part.stop - 1] - log.time[part.start])
        count = max(int(seconds / PIECE), min(2, int(seconds / SHORTEST)), 1)
        edges = np.linspace(part.start, part.stop, count + 1).round().astype(int)
        found += [log.rows(slice(start, stop)) for start, stop in pairwise(edges)]
    return [piece for piece in found if long_segments(piece) is not None]


def _where(logs: Mapping[str, MotorLog], joint: int) -> str:
    """Says from when to when a joint moves in the first log in which it does."""
    name, log = next((name, log) for name, log in logs.items() if joint in excited_joints(log))
    alone = awake(with_joints(log, [joint]))
    return f"{log.joint_names[joint]} moves from {alone.time[0]:.1f} to {alone.time[-1]:.1f} s of {name}"


def _spread(pieces: Sequence[tuple[str, MotorLog]], seconds: float) -> dict[str, MotorLog]:
    """So many seconds of them, from all over the list, and of every joint that moves a piece at least; by log."""
    count = min(len(pieces), max(1, round(seconds / PIECE)))
    taken = {round(place) for place in np.linspace(0, len(pieces) - 1, count)}
    moving = [set(excited_joints(piece).tolist()) for _, piece in pieces]
    for joint in sorted(set().union(*moving)):
        of_joint = [index for index, joints in enumerate(moving) if joint in joints]
        if taken.isdisjoint(of_joint):
            taken.add(of_joint[len(of_joint) // 2])
    found: dict[str, list[MotorLog]] = {}
    for index in sorted(taken):
        found.setdefault(pieces[index][0], []).append(pieces[index][1])
    return {name: joined(parts) for name, parts in found.items()}


def long_segments(log: MotorLog) -> MotorLog | None:
    """The log without segments that are shorter than SHORTEST; None if all are."""
    keep = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        keep[part] = part.stop - part.start > 1 and log.time[part.stop - 1] - log.time[part.start] >= SHORTEST
    return log.rows(keep) if keep.any() else None


def moving_joints(logs: Mapping[str, MotorLog]) -> list[int]:
    """Joints that were commanded to move in any of the logs, in order."""
    return sorted(_excited(logs))


def with_joints(log: MotorLog, joints: Sequence[int]) -> MotorLog:
    """The log of some of its joints."""
    series = {name: value[:, list(joints)] for name, value in channels(log).items() if name in JOINT_SERIES}
    return replace(log, joint_names=tuple(log.joint_names[joint] for joint in joints), **series)
