"""What of many logs models are fitted to, and what they are judged by: stretches of known length, never the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.joining import joined
from motorprior.logs.joint_checks import excited_joints
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog, channels, time_steps

MOST_LOGS = 16
"""Of more, so many are taken, from all over the list."""
SHORTEST = 1.5
"""Of a segment [s]: a free run of a second and what goes before it; shorter ones are left out."""
LEAST = 2.0
"""Of every log [s], however many there are."""


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
    rows = min(log.num_rows, round(seconds / count / float(np.median(time_steps(log)[1]))))
    first = round((log.num_rows - rows) * index / max(1, count - 1))
    return log.rows(slice(first, first + rows))


def split(logs: Mapping[str, MotorLog], known_seconds: float, judged_seconds: float) -> Split:
    """Every second log against the others, or first halves against second halves.

    Halves where there is one log only, or where a joint moved in judged logs that did not in known ones.

    Args:
        logs: of the same joints.
        known_seconds: of log to fit to, altogether, but at least LEAST of each.
        judged_seconds: of log to judge by, the same.

    Raises:
        LogError: no segment is as long as SHORTEST.
    """
    names = list(logs)
    names = [names[round(place)] for place in np.linspace(0, len(names) - 1, min(len(names), MOST_LOGS))]
    known, judged = ({name: logs[name] for name in names[first::2]} for first in (0, 1))
    told = f"known: {', '.join(known)}; judged: {', '.join(judged)}"
    if not judged or not _excited(judged) <= _excited(known):
        halves = {name: _halves(logs[name]) for name in names}
        known, judged = ({name: both[half] for name, both in halves.items()} for half in (0, 1))
        told = f"known: first half of {', '.join(names)}; judged: second half"
    if len(names) < len(logs):
        told = f"{len(names)} of {len(logs)} logs. {told}"
    return Split(_cut(known, known_seconds), _cut(judged, judged_seconds), told)


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
