"""Several logs become one: recordings of the same motors after one another, those of other motors side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import CONDITIONS, JOINT_SERIES, MotorLog, channels, other_firmware
from motorprior.logs.validity import checked


def joined(logs: Sequence[MotorLog]) -> MotorLog:
    """One log of all.

    Logs whose joints have the same names are recordings of the same motors. Logs whose joints all have other names are
    of further motors; they are cut to the shortest, and the first one's times stand for all.

    Raises:
        LogError: no log; logs that share some joints; of different robots, channels, encoders or firmware; or,
            side by side, with segments that begin at different rows.
    """
    if not logs:
        raise LogError("no log given", remedy="give at least one")
    first, names = logs[0], [name for log in logs for name in log.joint_names]
    for log in logs[1:]:
        _require_alike(first, log)
    if len(logs) == 1:
        return first
    if all(log.joint_names == first.joint_names for log in logs):
        return _after_one_another(logs)
    if len(set(names)) == len(names):
        return _side_by_side(logs)
    raise LogError(
        "the logs share some joints", where=_sources(logs),
        remedy="give each motor its own joint name, or give logs of the same joints in the same order",
    )  # fmt: skip


def _require_alike(first: MotorLog, log: MotorLog) -> None:
    for name in ("robot", "motor", "encoder", "gain_unit"):
        one, other = getattr(first, name), getattr(log, name)
        if one != other:
            raise LogError(f"{name} {other!r}, another log has {one!r}", where=log.source, remedy="fit one at a time")
    untold = sorted(first.firmware.keys() ^ log.firmware.keys())
    if untold or (other := other_firmware(log.firmware, first.firmware)):
        problem = f"firmware.{untold[0]} is stated by some of the logs only" if untold else other
        raise LogError(problem, where=log.source, remedy="import all with the same statement, or fit one at a time")
    if odd := sorted((channels(first).keys() ^ channels(log).keys()) - {"segment"}):
        conditions = set(odd) <= CONDITIONS.keys()
        remedy = "state it for the others, too, when they are imported" if conditions else "leave it out of all"
        raise LogError(f"only some of the logs have {', '.join(odd)}", where=log.source, remedy=remedy)


def _sources(logs: Sequence[MotorLog]) -> str:
    return "; ".join(dict.fromkeys(log.source for log in logs))


def _after_one_another(logs: Sequence[MotorLog]) -> MotorLog:
    parts = [part for log in logs for part in log.segments()]
    values: dict[str, Any] = {
        name: np.concatenate([channels(part)[name] for part in parts])
        for name in channels(parts[0])
        if name != "segment"
    }
    segment = np.repeat(np.arange(len(parts)), [part.num_rows for part in parts])
    return checked(replace(logs[0], **values, segment=segment, source=_sources(logs)), where=_sources(logs))


def _side_by_side(logs: Sequence[MotorLog]) -> MotorLog:
    rows = min(log.num_rows for log in logs)
    cut = [log.rows(slice(0, rows)) for log in logs]
    if any(log.segment_slices() != cut[0].segment_slices() for log in cut):
        raise LogError(
            "the logs' segments begin at different rows", where=_sources(logs), remedy="record all motors alike"
        )
    values: dict[str, Any] = {
        name: np.concatenate([channels(log)[name] for log in cut], axis=1)
        for name in channels(cut[0])
        if name in JOINT_SERIES
    }
    names = tuple(name for log in cut for name in log.joint_names)
    return checked(replace(cut[0], **values, joint_names=names, source=_sources(logs)), where=_sources(logs))
