"""Join logs: recordings of the same motors in sequence, recordings of different motors as further joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import JOINT_SERIES, MotorLog, channels, other_firmware
from motorprior.logs.validity import checked


def joined(logs: Sequence[MotorLog]) -> MotorLog:
    """Join logs into one.

    Logs with equal joint names become consecutive segments. Logs without common joint names are recordings of different
    motors: their joints become columns of one log, cut to the shortest and with the times of the first.

    Raises:
        LogError: no log; some joint names in common; different robots, channels, encoders, gain units or firmware; or,
            for different motors, segments that begin at different rows.
    """
    if not logs:
        raise LogError("no log given", remedy="give at least one")
    first, names = logs[0], [name for log in logs for name in log.joint_names]
    for log in logs[1:]:
        _require_equal_settings(first, log)
    if len(logs) == 1:
        return first
    source = "; ".join(dict.fromkeys(log.source for log in logs))
    if all(log.joint_names == first.joint_names for log in logs):
        return checked(replace(first, **_in_sequence(logs), source=source), where=source)
    if len(set(names)) == len(names):
        return checked(replace(_side_by_side(logs, source), joint_names=tuple(names), source=source), where=source)
    raise LogError(
        "some of the logs' joint names are equal", where=source,
        remedy="give each motor its own joint name, or give logs of the same joints in the same order",
    )  # fmt: skip


def _require_equal_settings(first: MotorLog, log: MotorLog) -> None:
    for name in ("robot", "motor", "encoder", "gain_unit"):
        one, other = getattr(first, name), getattr(log, name)
        if one != other:
            raise LogError(f"{name} {other!r}, another log has {one!r}", where=log.source, remedy="fit one at a time")
    unequal = sorted(first.firmware.keys() ^ log.firmware.keys())
    if unequal or (other := other_firmware(log.firmware, first.firmware)):
        problem = f"only some of the logs have firmware.{unequal[0]}" if unequal else other
        raise LogError(problem, where=log.source, remedy="import all with the same registers, or fit one at a time")
    if missing := sorted((channels(first).keys() ^ channels(log).keys()) - {"segment"}):
        problem = f"only some of the logs have {', '.join(missing)}"
        raise LogError(problem, where=log.source, remedy="add it to the others at their import, or remove it from all")


def _in_sequence(logs: Sequence[MotorLog]) -> dict[str, Any]:
    parts = [part for log in logs for part in log.segments()]
    names = channels(parts[0]).keys() - {"segment"}
    values = {name: np.concatenate([channels(part)[name] for part in parts]) for name in names}
    return values | {"segment": np.repeat(np.arange(len(parts)), [part.num_rows for part in parts])}


def _side_by_side(logs: Sequence[MotorLog], source: str) -> MotorLog:
    rows = min(log.num_rows for log in logs)
    cut = [log.rows(slice(0, rows)) for log in logs]
    if any(log.segment_slices() != cut[0].segment_slices() for log in cut):
        problem = "the logs' segments begin at different rows"
        raise LogError(problem, where=source, remedy="record all motors with the same segments")
    values: dict[str, Any] = {
        name: np.concatenate([channels(log)[name] for log in cut], axis=1)
        for name in channels(cut[0])
        if name in JOINT_SERIES
    }
    return replace(cut[0], **values)
