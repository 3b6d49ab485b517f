"""Checks that make a `MotorLog` usable: shapes, finite values, time, segments, bounds; common errors of logs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.bounds import first_not_finite, is_number
from motorprior.exceptions import LogError, listed, quoted
from motorprior.logs.motor_log import (
    BASE_AXES,
    CODES,
    CONDITION_UNITS,
    CONDITIONS,
    ENCODERS,
    FIRMWARE,
    GAIN_UNITS,
    JOINT_SERIES,
    POSTURES,
    MotorLog,
    channels,
    column_name,
)

CORRECT = "correct the column map, or the file"
CORRECT_ROW = "correct or remove the row"
NUMBER = "a finite number"
Where = str | Path | None
_TINY = float(np.nextafter(0.0, 1.0))
_BOUNDS = {  # lowest and highest value, and what it is
    "load_inertia": (_TINY, np.inf, "a positive inertia [kg·m²]"),
    "stated_kp": (_TINY, np.inf, "a positive gain"),
    "stated_kd": (0.0, np.inf, "a gain of 0 or more"),
    "posture": (0, len(POSTURES) - 1, f"the index of one of {', '.join(POSTURES)}"),
    **{name: (a, b, f"from {a:g} to {b:g} {CONDITION_UNITS[name]}") for name, (a, b) in CONDITIONS.items()},
}


def checked(log: MotorLog, where: Where = None) -> MotorLog:
    """Return the log with float64 arrays and sorted firmware registers, or raise.

    Args:
        log: channels may be any array-like; rows count from 0.
        where: file to name in the error, by default the log's source.

    Raises:
        LogError: wrong shape, a value that is not finite or out of its bounds, time that does not increase within a
            segment, a segment of fewer than 2 rows or in two places, gains that change within a segment, or an unknown
            encoder, gain unit, posture or register; names row, column and value.
    """
    where = where or log.source
    for name, allowed in (("encoder", ENCODERS), ("gain_unit", GAIN_UNITS)):
        if (value := getattr(log, name)) not in allowed:
            raise LogError(f"{name} {value!r}", where=where, remedy=f"give {' or '.join(allowed)}")
    if len(log.stated_classes) not in (0, log.num_joints):
        problem = f"{len(log.stated_classes)} joint classes for {log.num_joints} joints"
        raise LogError(problem, where=where, remedy="give one per joint, or none")
    for name, value in log.firmware.items():
        if name not in FIRMWARE:
            raise LogError(f"firmware {name!r}", where=where, remedy=f"give some of {', '.join(FIRMWARE)}")
        low, high = FIRMWARE[name]
        if value != 0 and not is_number(value, low, high):
            problem = f"firmware.{name} {quoted(value)} is not 0 (off) or a number from {low:g} to {high:g}"
            raise LogError(problem, where=where, remedy="give it in rad, rad/s or rad/s², or leave it out")
    log = replace(_as_arrays(log, where), firmware={name: float(log.firmware[name]) for name in sorted(log.firmware)})
    for name, value in channels(log).items():
        table = value[:, None] if value.ndim == 1 else value
        columns = [column_name(name, index, log.joint_names) for index in range(table.shape[1])]
        require_finite(table, columns, where)
        low, high, expected = _BOUNDS.get(name, (-np.inf, np.inf, ""))
        if np.any(outside := (table < low) | (table > high)):
            row, column = np.argwhere(outside)[0].tolist()
            remedy = "correct it, or leave the channel out"
            raise bad_value(row, columns[column], table[row, column], expected, where, remedy)
    _check_segments(log, where)
    return log


def _as_arrays(log: MotorLog, where: Where) -> MotorLog:
    if log.num_joints < 1 or len(set(log.joint_names)) != log.num_joints:
        problem = f"joint names {list(log.joint_names)} are empty or repeat"
        raise LogError(problem, where=where, remedy="give every joint its own name")
    arrays: dict[str, Any] = {}
    rows, joints = np.size(log.time), log.num_joints
    wanted = {"time": (rows,), **dict.fromkeys(CODES, (rows,)), "base_orientation": (rows, len(BASE_AXES))}
    for name in ("time", *JOINT_SERIES, *CODES, "base_orientation"):
        kind, words = (np.int64, "integers") if name in CODES else (np.float64, "numbers")
        if (value := getattr(log, name)) is None:
            continue
        try:
            arrays[name] = np.asarray(value).astype(kind, casting="same_kind", copy=False)
        except (ValueError, TypeError) as error:
            problem = f"{name} is not an array of {words} ({error})"
            raise LogError(problem, where=where, remedy=f"give {words} in every row") from error
        found, shape = arrays[name].shape, wanted.get(name, (rows, joints))
        if found != shape:
            problem = f"{name} has shape {found}, expected {shape} ({rows} rows, {joints} joints)"
            raise LogError(problem, where=where, remedy="give one row per time and one column per joint name")
    return replace(log, joint_names=tuple(log.joint_names), **arrays)


def _check_segments(log: MotorLog, where: Where) -> None:
    """Rows, times and gains within segments."""
    if log.stated_kp is None and log.stated_kd is not None:
        raise LogError("kd without kp", where=where, remedy="give both, or kp alone")
    seen: set[int] = set()
    for part in log.segment_slices():
        index = 0 if log.segment is None or not log.num_rows else int(log.segment[part.start])
        if part.stop - part.start < 2:
            problem = f"segment {index} has {part.stop - part.start} rows, at least 2 are needed"
            raise LogError(problem, where=where, remedy="record longer, or drop the segment")
        if index in seen:
            problem = f"row {part.start}: segment {index} starts again after it ended"
            raise LogError(problem, where=where, remedy="give each contiguous recording its own index")
        seen.add(index)
        require_increasing(log.time[part], where, part.start)
        for name in ("stated_kp", "stated_kd"):
            gains = getattr(log, name)
            if gains is not None and np.any(changed := gains[part] != gains[part.start]):
                row, column = np.argwhere(changed)[0].tolist()
                problem = (
                    f"row {part.start + row}, {column_name(name, column, log.joint_names)} changes within a segment"
                )
                raise LogError(problem, where=where, remedy="begin a segment where gains change, or leave them out")


def bad_value(row: int, column: str, value: Any, expected: str, where: Where, remedy: str = CORRECT_ROW) -> LogError:
    """The error for one cell, as "row 7, joint_pos/knee is nan, not a finite number"; rows count from 0."""
    text = quoted(value.item() if isinstance(value, np.generic) else value)
    return LogError(f"row {row}, {column[:120]} is {text}, not {expected}", where=where, remedy=remedy)


def missing_column(kind: str, name: str, known: Iterable[str], where: Where, remedy: str = CORRECT) -> LogError:
    """The error for a missing column, tensor or topic; it lists the first eight that exist."""
    have = listed([quoted(each) for each in known], 8) or "none"
    return LogError(f"no {kind} {quoted(name, 80)}; it has {have[:300]}", where=where, remedy=remedy)


def require_finite(values: np.ndarray, columns: list[str], where: Where) -> None:
    """Raise LogError, with row, column and value, unless values (T, N) are finite."""
    if (place := first_not_finite(values)) is not None:
        row, column = place
        raise bad_value(row, columns[column], values[row, column], NUMBER, where)


def require_increasing(time: np.ndarray, where: Where, first_row: int = 0) -> None:
    """Raise LogError, with the row counted from ``first_row`` and both values, unless times (T,) [s] increase."""
    stuck = np.diff(time) <= 0.0
    if stuck.any():
        row = 1 + int(np.argmax(stuck))
        before, now = float(time[row - 1]), float(time[row])
        problem = f"row {first_row + row}, time {'repeats' if before == now else 'runs backwards'}"
        remedy = "sort the rows and drop duplicates, or begin a segment where the clock restarted"
        raise LogError(f"{problem}: {now!r} s after {before!r} s, it must increase", where=where, remedy=remedy)
