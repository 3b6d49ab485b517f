"""Splits of logs into rows to train on and rows to test on, which never overlap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.doctor.excitation import EXCITED_STD, excited_joints
from motorprior.logs.joining import joined
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog, channels

MAX_LOGS = 16  # if there are more, this many are used, evenly spread over the list
MIN_SEGMENT = 1.5  # a free run of 1 s and its warm-up [s]; shorter segments are left out
MIN_SECONDS = 2.0  # of every log [s]
CHUNK = 2.5  # duration of chunks that alternate between training and test [s]


@dataclass(frozen=True)
class Split:
    """Logs to train on and to test on, by name, and the rule by which they were split."""

    train: dict[str, MotorLog]
    test: dict[str, MotorLog]
    rule: str

    def map(self, change: Callable[[MotorLog], MotorLog]) -> Split:
        """The same split with a function applied to every log."""
        train, test = ({name: change(log) for name, log in logs.items()} for logs in (self.train, self.test))
        return Split(train, test, self.rule)


def spread_windows(logs: Sequence[MotorLog], seconds: float) -> MotorLog:
    """A window of each log, ``seconds`` in all, from the beginning of the first to the end of the last.

    Logs of the same motion cover it together; a log that is shorter than its window is used whole.
    """
    return joined([_window(log, seconds, index, len(logs)) for index, log in enumerate(logs)])


def _window(log: MotorLog, seconds: float, index: int, count: int) -> MotorLog:
    rows = min(log.num_rows, round(seconds / count / log.period))
    first = round((log.num_rows - rows) * index / max(1, count - 1))
    return log.rows(slice(first, first + rows))


def split(logs: Mapping[str, MotorLog], train_seconds: float, test_seconds: float) -> Split:
    """Split into every second log and the others, into halves, or into alternating chunks.

    Halves if there is one log, or if a joint moves in the test logs only. Chunks if different joints move in the two
    halves, as where joints are moved one after the other. Static rows at the ends of a log are left out.

    Args:
        logs: of the same joints, of which some move.
        train_seconds: duration of all training rows [s], at least MIN_SECONDS per log.
        test_seconds: duration of all test rows [s], likewise.

    Raises:
        LogError: no segment is as long as MIN_SEGMENT, or no joint moves in both parts.
    """
    names = list(logs)
    names = [names[round(place)] for place in np.linspace(0, len(names) - 1, min(len(names), MAX_LOGS))]
    used = {name: _moving_part(logs[name]) for name in names}
    used = {name: log if log.duration >= 2.0 * MIN_SECONDS else logs[name] for name, log in used.items()}
    train, test = ({name: used[name] for name in names[first::2]} for first in (0, 1))
    rule = f"train: {', '.join(train)}; test: {', '.join(test)}"
    if test:
        train, test = _windows(train, train_seconds), _windows(test, test_seconds)
    if not test or not set() < _excited(test) <= _excited(train):
        halves = {name: _halves(log) for name, log in used.items()}
        train, test = ({name: both[half] for name, both in halves.items()} for half in (0, 1))
        train, test = _windows(train, train_seconds), _windows(test, test_seconds)
        rule = f"train: first half of {', '.join(names)}; test: second half"
    if not _excited(test) or _excited(test) != _excited(train):
        train, test = _chunks(used, train_seconds, test_seconds)
        rule = f"train and test: alternating chunks of {CHUNK:g} s of {', '.join(names)}"
    if len(names) < len(logs):
        rule = f"{len(names)} of {len(logs)} logs. {rule}"
    return Split(train, test, rule)


def _moving_part(log: MotorLog) -> MotorLog:
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


def _windows(logs: Mapping[str, MotorLog], seconds: float) -> dict[str, MotorLog]:
    found = {
        name: long_segments(_window(log, max(seconds, MIN_SECONDS * len(logs)), index, len(logs)))
        for index, (name, log) in enumerate(logs.items())
    }  # fmt: skip
    if kept := {name: log for name, log in found.items() if log is not None}:
        return kept
    raise _too_short(logs)


def _too_short(logs: Mapping[str, MotorLog]) -> LogError:
    where = next(iter(logs.values())).source
    return LogError(f"no segment of {MIN_SEGMENT:g} s", where=where, remedy="give longer recordings")


def _chunks(
    logs: Mapping[str, MotorLog], train_seconds: float, test_seconds: float
) -> tuple[dict[str, MotorLog], dict[str, MotorLog]]:
    """Chunks of logs to train on and to test on; every joint moves in as many chunks of both as possible.

    Raises:
        LogError: no segment is as long as MIN_SEGMENT, or no joint moves in chunks of both.
    """
    chunks = [(name, chunk) for name, log in logs.items() for chunk in _cut(log)]
    if not chunks:
        raise _too_short(logs)
    first = chunks[0][1]
    counts, sides = np.zeros((2, first.num_joints), dtype=int), ([], [])
    for name, chunk in chunks:
        moving = excited_joints(chunk)
        side = int(counts[0, moving].sum() > counts[1, moving].sum())
        counts[side, moving] += moving.size > 0
        if moving.size:
            sides[side].append((name, chunk))
    if not counts.all(axis=0).any():
        problem = f"no joint moves in two chunks of {MIN_SEGMENT:g} s, one to train on and one to test on"
        where = next(iter(logs.values())).source
        raise LogError(problem, where=where, remedy="move every joint for 5 s or more")
    return _spread(sides[0], train_seconds), _spread(sides[1], test_seconds)


def _cut(log: MotorLog) -> list[MotorLog]:
    """Chunks of about CHUNK, at least two of a segment that is long enough."""
    found = []
    for part in log.segment_slices():
        seconds = float(log.time[part.stop - 1] - log.time[part.start])
        count = max(int(seconds / CHUNK), min(2, int(seconds / MIN_SEGMENT)), 1)
        edges = np.linspace(part.start, part.stop, count + 1).round().astype(int)
        found += [log.rows(slice(start, stop)) for start, stop in pairwise(edges)]
    return [chunk for chunk in found if long_segments(chunk) is not None]


def _spread(chunks: Sequence[tuple[str, MotorLog]], seconds: float) -> dict[str, MotorLog]:
    """Evenly spread chunks of ``seconds`` in all, with each joint moving in at least one; joined by log."""
    count = min(len(chunks), max(1, round(seconds / CHUNK)))
    taken = {round(place) for place in np.linspace(0, len(chunks) - 1, count)}
    moving = [set(excited_joints(chunk).tolist()) for _, chunk in chunks]
    for joint in sorted(set().union(*moving)):
        of_joint = [index for index, joints in enumerate(moving) if joint in joints]
        if taken.isdisjoint(of_joint):
            taken.add(of_joint[len(of_joint) // 2])
    found: dict[str, list[MotorLog]] = {}
    for index in sorted(taken):
        found.setdefault(chunks[index][0], []).append(chunks[index][1])
    return {name: joined(parts) for name, parts in found.items()}


def long_segments(log: MotorLog) -> MotorLog | None:
    """The log without segments shorter than MIN_SEGMENT; None if all are."""
    keep = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        keep[part] = part.stop - part.start > 1 and log.time[part.stop - 1] - log.time[part.start] >= MIN_SEGMENT
    return log.rows(keep) if keep.any() else None


def moving_joints(logs: Mapping[str, MotorLog]) -> list[int]:
    """Joints that are excited in any of the logs, in order."""
    return sorted(_excited(logs))


def with_joints(log: MotorLog, joints: Sequence[int]) -> MotorLog:
    """The log of some of its joints."""
    series = {name: value[:, list(joints)] for name, value in channels(log).items() if name in JOINT_SERIES}
    return replace(log, joint_names=tuple(log.joint_names[joint] for joint in joints), **series)
