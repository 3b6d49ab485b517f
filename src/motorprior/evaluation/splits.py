"""Splits of logs into rows to train on and rows to test on, which never overlap."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError, LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import EXCITED_STD, excited_joints, joined

MAX_LOGS = 16  # of more logs, this many are used, evenly spread over the list
MIN_SEGMENT = 0.5  # a warm-up and a short free run [s]; shorter segments are left out
MIN_CHUNK = 1.5  # a warm-up and a free run of 1 s [s]; segments are not cut into shorter chunks
MIN_SECONDS = 2.0  # minimum duration of a log [s]
CHUNK = 2.5  # duration of chunks that alternate between training and test [s]


@dataclass(frozen=True)
class Split:
    """Logs to train on and to test on, by name, and the rule by which they were split."""

    train: dict[str, MotorLog]
    test: dict[str, MotorLog]
    rule: str

    def with_joints(self, joints: Sequence[int]) -> "Split":
        """The same split with these joints only."""
        train = {name: log.with_joints(joints) for name, log in self.train.items()}
        test = {name: log.with_joints(joints) for name, log in self.test.items()}
        return Split(train, test, self.rule)


def evenly_spread(names: list[str]) -> list[str]:
    """At most MAX_LOGS of the names, evenly spread over the list."""
    places = np.linspace(0, len(names) - 1, min(len(names), MAX_LOGS)).tolist()
    return [names[round(place)] for place in places]


def first_and_rest(log: MotorLog, seconds: float) -> tuple[MotorLog, MotorLog]:
    """The first seconds of a log and the rest, without segments of a single row.

    Raises ConfigError if nothing remains.
    """
    require_number("seconds", seconds, 0.0, log.duration)
    period = float(np.median(np.diff(log.time)))
    first = log.rows(slice(0, max(2, round(seconds / period))))
    last_segment = first.segment_slices()[-1]
    if last_segment.stop - last_segment.start < 2:
        first = first.rows(slice(0, last_segment.start))

    rest = log.rows(slice(first.num_rows, None))
    for segment in rest.segment_slices():
        if segment.stop - segment.start > 1:
            return first, rest.rows(slice(segment.start, None))
    problem = f"seconds {seconds:g} of {log.duration:.4g} s of log: nothing remains"
    raise ConfigError(problem, where=log.source, remedy="give fewer seconds", argument="seconds")


def long_segments(log: MotorLog) -> MotorLog | None:
    """The log without segments shorter than MIN_SEGMENT; None if all are."""
    keep = np.zeros(log.num_rows, dtype=bool)
    for segment in log.segment_slices():
        rows = segment.stop - segment.start
        seconds = log.time[segment.stop - 1] - log.time[segment.start]
        keep[segment] = rows > 1 and seconds >= MIN_SEGMENT
    return log.rows(keep) if keep.any() else None


def excited_in_any(logs: Mapping[str, MotorLog]) -> list[int]:
    """Joints that are excited in any of the logs, in order."""
    joints: set[int] = set()
    for log in logs.values():
        joints.update(int(joint) for joint in excited_joints(log))
    return sorted(joints)


def window(log: MotorLog, seconds: float, index: int, count: int) -> MotorLog:
    """The window of ``seconds / count`` of log ``index`` of ``count``.

    The window of the first log begins with its log, the window of the last log ends with its log.
    """
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
    moving = {name: _moving_part(log) for name, log in logs.items()}
    if len(names) > 1:
        to_train = {name: moving[name] for name in names[0::2]}
        to_test = {name: moving[name] for name in names[1::2]}
        train = _windows(to_train, train_seconds)
        test = _windows(to_test, test_seconds)
        tested_joints = set(excited_in_any(test))
        if tested_joints and tested_joints <= set(excited_in_any(train)):
            rule = f"train: {', '.join(to_train)}; test: {', '.join(to_test)}"
            return Split(train, test, rule)

    listed_names = ", ".join(names)
    first_half = {}
    second_half = {}
    for name, log in moving.items():
        middle = log.num_rows // 2
        first_half[name] = log.rows(slice(0, middle))
        second_half[name] = log.rows(slice(middle, None))
    train = _windows(first_half, train_seconds)
    test = _windows(second_half, test_seconds)
    joints = excited_in_any(test)
    if joints and joints == excited_in_any(train):
        return Split(train, test, f"train: first half of {listed_names}; test: second half")

    train_chunks, test_chunks = _chunks(moving)
    train = _evenly_spaced(train_chunks, train_seconds)
    test = _evenly_spaced(test_chunks, test_seconds)
    rule = f"train and test: alternating chunks of {CHUNK:g} s of {listed_names}"
    return Split(train, test, rule)


def alternating_chunks(log: MotorLog, seconds: float) -> tuple[MotorLog, MotorLog]:
    """Chunks of a log in turn, for training and for a test, of about ``seconds`` each.

    Raises LogError if no joint moves in both.
    """
    train, test = _chunks({log.source: log})
    pieces = [_evenly_spaced(chunks, seconds) for chunks in (train, test)]
    return pieces[0][log.source], pieces[1][log.source]


def _moving_part(log: MotorLog) -> MotorLog:
    """From the row before the first change of a command to the row after the last.

    The whole log if that is short, or if no command changes.
    """
    target = log.position_target
    differs_from_first = np.abs(target - target[0]).max(axis=1) > EXCITED_STD
    differs_from_last = np.abs(target - target[-1]).max(axis=1) > EXCITED_STD
    if not differs_from_first.any():
        return log

    first = int(differs_from_first.argmax())
    after = log.num_rows - int(differs_from_last[::-1].argmax())
    moving = log.rows(slice(max(0, first - 1), after + 1))
    return moving if moving.duration >= 2.0 * MIN_SECONDS else log


def _windows(logs: Mapping[str, MotorLog], seconds: float) -> dict[str, MotorLog]:
    """A window of every log that has long segments, of ``seconds`` in all; LogError if none has."""
    total = max(seconds, MIN_SECONDS * len(logs))
    windows = {}
    for index, (name, log) in enumerate(logs.items()):
        long = long_segments(window(log, total, index, len(logs)))
        if long is not None:
            windows[name] = long
    if not windows:
        where = next(iter(logs.values())).source
        problem = f"no segment of {MIN_SEGMENT:g} s"
        raise LogError(problem, where=where, remedy="give longer recordings")
    return windows


def _chunks(
    logs: Mapping[str, MotorLog],
) -> tuple[list[tuple[str, MotorLog]], list[tuple[str, MotorLog]]]:
    """Chunks to train on and to test on, with the names of their logs.

    Every joint moves in as many chunks of both as possible; LogError if none moves in both.
    """
    first_log = next(iter(logs.values()))
    counts = np.zeros((2, first_log.num_joints), dtype=int)
    sides: tuple[list[tuple[str, MotorLog]], list[tuple[str, MotorLog]]] = ([], [])
    for name, log in logs.items():
        for chunk in _cut(log):
            moving = excited_joints(chunk)
            side = int(counts[0, moving].sum() > counts[1, moving].sum())
            counts[side, moving] += 1
            if moving.size:
                sides[side].append((name, chunk))

    if not counts.all(axis=0).any():
        problem = (
            f"no joint moves in two chunks of {MIN_SEGMENT:g} s, one to train on and one to test on"
        )
        raise LogError(problem, where=first_log.source, remedy="move every joint for 5 s or more")
    return sides


def _cut(log: MotorLog) -> list[MotorLog]:
    """Chunks of about CHUNK, at least two of a segment that is long enough.

    A segment that is shorter than two chunks of MIN_CHUNK is one chunk.
    """
    chunks = []
    for segment in log.segment_slices():
        seconds = float(log.time[segment.stop - 1] - log.time[segment.start])
        possible = int(seconds / MIN_CHUNK)
        count = max(int(seconds / CHUNK), min(2, possible), 1)
        edges = np.linspace(segment.start, segment.stop, count + 1)
        edges = edges.round().astype(int)
        for start, stop in pairwise(edges):
            chunk = log.rows(slice(start, stop))
            if long_segments(chunk) is not None:
                chunks.append(chunk)
    return chunks


def _evenly_spaced(chunks: Sequence[tuple[str, MotorLog]], seconds: float) -> dict[str, MotorLog]:
    """Evenly spread chunks of ``seconds`` in all, joined by log.

    Each joint moves in at least one chunk.
    """
    mean_duration = float(np.mean([chunk.duration for _, chunk in chunks]))
    count = min(len(chunks), max(1, round(seconds / mean_duration)))
    places = np.linspace(0, len(chunks) - 1, count)
    taken = {round(place) for place in places}

    moving = [set(excited_joints(chunk).tolist()) for _, chunk in chunks]
    for joint in sorted(set().union(*moving)):
        with_joint = [index for index, joints in enumerate(moving) if joint in joints]
        if taken.isdisjoint(with_joint):
            taken.add(with_joint[len(with_joint) // 2])

    by_log: dict[str, list[MotorLog]] = {}
    for index in sorted(taken):
        name, chunk = chunks[index]
        by_log.setdefault(name, []).append(chunk)
    return {name: joined(log_chunks) for name, log_chunks in by_log.items()}
