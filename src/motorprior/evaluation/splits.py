"""Splits of logs into rows to train on and rows to test on, which never overlap."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import EXCITED_STD, excited_joints, joined

MAX_LOGS = 16  # if there are more, this many are used, evenly spread over the list
MIN_SEGMENT = 1.5  # a free run of 1 s and its warm-up [s]; shorter segments are left out
MIN_SECONDS = 2.0  # minimum duration of a log [s]
CHUNK = 2.5  # duration of chunks that alternate between training and test [s]


@dataclass(frozen=True)
class Split:
    """Logs to train on and to test on, by name, and the rule by which they were split."""

    train: dict[str, MotorLog]
    test: dict[str, MotorLog]
    rule: str

    def map(self, change: Callable[[MotorLog], MotorLog]) -> "Split":
        """The same split with a function applied to every log."""
        train, test = (
            {name: change(log) for name, log in logs.items()} for logs in (self.train, self.test)
        )
        return Split(train, test, self.rule)


def first_and_rest(log: MotorLog, seconds: float) -> tuple[MotorLog, MotorLog]:
    """The first seconds of a log and the rest, without segments of a single row; ConfigError if no rest remains."""
    require_number("seconds", seconds, 0.0, log.duration)
    first = log.rows(slice(0, max(2, round(seconds / float(np.median(np.diff(log.time)))))))
    last = first.segment_slices()[-1]
    first = first.rows(slice(0, last.start)) if last.stop - last.start < 2 else first
    rest = log.rows(slice(first.num_rows, None))
    starts = [part.start for part in rest.segment_slices() if part.stop - part.start > 1]
    if not starts:
        problem = f"seconds {seconds:g} of {log.duration:.4g} s of log: nothing remains"
        raise ConfigError(
            problem, where=log.source, remedy="give fewer seconds", argument="seconds"
        )
    return first, rest.rows(slice(starts[0], None))


def long_segments(log: MotorLog) -> MotorLog | None:
    """The log without segments shorter than MIN_SEGMENT; None if all are."""
    keep = np.zeros(log.num_rows, dtype=bool)
    for part in log.segment_slices():
        keep[part] = (
            part.stop - part.start > 1
            and log.time[part.stop - 1] - log.time[part.start] >= MIN_SEGMENT
        )
    return log.rows(keep) if keep.any() else None


def excited_in_any(logs: Mapping[str, MotorLog]) -> list[int]:
    """Joints that are excited in any of the logs, in order."""
    return sorted({int(joint) for log in logs.values() for joint in excited_joints(log)})


def window(log: MotorLog, seconds: float, index: int, count: int) -> MotorLog:
    """The window of ``seconds / count`` of log ``index`` of ``count``: the first begins its log, the last ends it."""
    rows = min(log.num_rows, round(seconds / count / log.period))
    first = round((log.num_rows - rows) * index / max(1, count - 1))
    return log.rows(slice(first, first + rows))


def split(logs: Mapping[str, MotorLog], train_seconds: float, test_seconds: float) -> Split:
    """Split into every second log and the others, into halves, or into alternating chunks.

    Halves if there is one log, or if a joint moves in the test logs only. Chunks if different
    joints move in the two halves, as where joints are moved one after the other. Static rows at the
    ends of a log are left out. The durations [s] are of all training and of all test rows, at least
    MIN_SECONDS per log.

    Raises LogError if no segment is as long as MIN_SEGMENT, or no joint moves in both parts.
    """
    names = list(logs)
    seconds = (train_seconds, test_seconds)
    names = [
        names[round(place)] for place in np.linspace(0, len(names) - 1, min(len(names), MAX_LOGS))
    ]
    used = {name: _moving_part(logs[name]) for name in names}
    chosen = f"{len(names)} of {len(logs)} logs. " if len(names) < len(logs) else ""
    if len(names) > 1:
        sides = [{name: used[name] for name in names[first::2]} for first in (0, 1)]
        train, test = map(_windows, sides, seconds)
        if set() < set(excited_in_any(test)) <= set(excited_in_any(train)):
            return Split(
                train, test, f"{chosen}train: {', '.join(sides[0])}; test: {', '.join(sides[1])}"
            )
    first = {name: log.rows(slice(0, log.num_rows // 2)) for name, log in used.items()}
    second = {name: log.rows(slice(log.num_rows // 2, None)) for name, log in used.items()}
    train, test = map(_windows, (first, second), seconds)
    if [] != excited_in_any(test) == excited_in_any(train):
        return Split(
            train, test, f"{chosen}train: first half of {', '.join(names)}; test: second half"
        )
    train, test = map(_evenly_spaced, _chunks(used), seconds)
    return Split(
        train,
        test,
        f"{chosen}train and test: alternating chunks of {CHUNK:g} s of {', '.join(names)}",
    )


def _moving_part(log: MotorLog) -> MotorLog:
    """From the row before the first change of a command to the row after the last; the whole log if that is short."""
    changed = [
        np.abs(log.position_target - log.position_target[row]).max(axis=1) > EXCITED_STD
        for row in (0, -1)
    ]
    if not changed[0].any():
        return log
    first = int(changed[0].argmax())
    after = log.num_rows - int(changed[1][::-1].argmax())
    moving = log.rows(slice(max(0, first - 1), after + 1))
    return moving if moving.duration >= 2.0 * MIN_SECONDS else log


def _windows(logs: Mapping[str, MotorLog], seconds: float) -> dict[str, MotorLog]:
    each = max(seconds, MIN_SECONDS * len(logs))
    windows = [
        long_segments(window(log, each, index, len(logs)))
        for index, log in enumerate(logs.values())
    ]
    kept = {name: log for name, log in zip(logs, windows, strict=True) if log is not None}
    if not kept:
        where = next(iter(logs.values())).source
        raise LogError(
            f"no segment of {MIN_SEGMENT:g} s", where=where, remedy="give longer recordings"
        )
    return kept


def _chunks(
    logs: Mapping[str, MotorLog],
) -> tuple[list[tuple[str, MotorLog]], list[tuple[str, MotorLog]]]:
    """Chunks to train on and to test on; every joint moves in as many chunks of both as possible."""
    first = next(iter(logs.values()))
    counts = np.zeros((2, first.num_joints), dtype=int)
    sides = ([], [])
    for name, chunk in [(name, chunk) for name, log in logs.items() for chunk in _cut(log)]:
        moving = excited_joints(chunk)
        side = int(counts[0, moving].sum() > counts[1, moving].sum())
        counts[side, moving] += 1
        if moving.size:
            sides[side].append((name, chunk))
    if not counts.all(axis=0).any():
        problem = (
            f"no joint moves in two chunks of {MIN_SEGMENT:g} s, one to train on and one to test on"
        )
        raise LogError(problem, where=first.source, remedy="move every joint for 5 s or more")
    return sides


def _cut(log: MotorLog) -> list[MotorLog]:
    """Chunks of about CHUNK, at least two of a segment that is long enough."""
    found = []
    for part in log.segment_slices():
        seconds = float(log.time[part.stop - 1] - log.time[part.start])
        count = max(int(seconds / CHUNK), min(2, int(seconds / MIN_SEGMENT)), 1)
        edges = np.linspace(part.start, part.stop, count + 1).round().astype(int)
        found += [log.rows(slice(start, stop)) for start, stop in pairwise(edges)]
    return [chunk for chunk in found if long_segments(chunk) is not None]


def _evenly_spaced(chunks: Sequence[tuple[str, MotorLog]], seconds: float) -> dict[str, MotorLog]:
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
