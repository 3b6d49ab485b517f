"""What makes a `MotorLog` unusable: everything that `checked` refuses, with the row, the column and the value."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError, shown
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
    is_register,
)


def checked(log: MotorLog, where: str | Path | None = None) -> MotorLog:
    """Return the log with float64 arrays and an ordered firmware, or say what is wrong with it.

    Args:
        log: any channel may be any array-like; rows count from 0.
        where: file to name in the error.

    Raises:
        LogError: wrong shape or joint count, a value that is not finite (row, column, value), time that
            does not increase within a segment (row, both values), a load inertia that is not positive,
            fewer than 2 rows in a segment, an unknown posture, place of the encoder, unit of gains or register of the
            firmware, a register, voltage or temperature out of its bounds, or stated gains that change within a
            segment, or that are not positive (kd: negative).
    """
    if log.encoder not in ENCODERS:
        raise LogError(f"encoder {log.encoder!r}", where=where, remedy=f"give {' or '.join(ENCODERS)}")
    if log.gain_unit not in GAIN_UNITS:
        raise LogError(f"gain_unit {log.gain_unit!r}", where=where, remedy=f"give {' or '.join(GAIN_UNITS)}")
    _check_firmware(log, where)
    log = replace(_as_arrays(log, where), firmware={name: float(log.firmware[name]) for name in sorted(log.firmware)})
    _check_shapes(log, where)
    _check_finite(log, where)
    _check_segments(log, where)
    _check_time(log, where)
    _check_load(log, where)
    _check_gains(log, where)
    _check_conditions(log, where)
    _check_posture(log, where)
    return log


def _as_arrays(log: MotorLog, where: str | Path | None) -> MotorLog:
    """Convert every channel: whole numbers to int64, the others to float64."""
    arrays: dict[str, Any] = {}
    for name in ("time", *JOINT_SERIES, *CODES, "base_orientation"):
        value = getattr(log, name)
        if value is None:
            continue
        try:
            arrays[name] = _integers(value) if name in CODES else np.asarray(value, dtype=np.float64)
        except (ValueError, TypeError) as error:
            raise LogError(
                f"{name} is not an array of numbers ({error})",
                where=where,
                remedy="give every row as numbers",
            ) from error
    return replace(log, joint_names=tuple(log.joint_names), **arrays)


def _integers(value: Any) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "iu":
        raise ValueError(f"its type is {array.dtype}, not integer")
    return array.astype(np.int64)


def _check_shapes(log: MotorLog, where: str | Path | None) -> None:
    if log.num_joints < 1 or len(set(log.joint_names)) != log.num_joints:
        raise LogError(
            f"joint names {list(log.joint_names)} are empty or repeat",
            where=where,
            remedy="give every joint its own name",
        )
    rows, joints = log.time.size, log.num_joints
    wanted = {"time": (rows,), **dict.fromkeys(CODES, (rows,)), "base_orientation": (rows, len(BASE_AXES))}
    for name, value in channels(log).items():
        shape = wanted.get(name, (rows, joints))
        if value.shape != shape:
            raise LogError(
                f"{name} has shape {value.shape}, expected {shape} ({rows} rows, {joints} joints)",
                where=where,
                remedy="give one row per time and one column per joint name",
            )


def _check_finite(log: MotorLog, where: str | Path | None) -> None:
    for name, value in channels(log).items():
        finite = np.isfinite(value)
        if not finite.all():
            row, *column = np.argwhere(~finite)[0].tolist()
            label = column_name(name, column[0] if column else 0, log.joint_names)
            bad = value[(row, *column)]
            raise LogError(
                f"row {row}, {label} is {bad}, not a finite number",
                where=where,
                remedy="remove the row, or split the recording into two segments there",
            )


def _check_segments(log: MotorLog, where: str | Path | None) -> None:
    seen: set[int] = set()
    for part in log.segment_slices():
        index = 0 if log.segment is None or not log.num_rows else int(log.segment[part.start])
        if part.stop - part.start < 2:
            raise LogError(
                f"segment {index} has {part.stop - part.start} rows, at least 2 are needed",
                where=where,
                remedy="record longer, or drop the segment",
            )
        if index in seen:
            raise LogError(
                f"row {part.start}: segment {index} starts again after it ended",
                where=where,
                remedy="give each contiguous recording its own index",
            )
        seen.add(index)


def _check_time(log: MotorLog, where: str | Path | None) -> None:
    for part in log.segment_slices():  # one after another: of a long log, every array takes a lot of memory
        stuck = np.diff(log.time[part]) <= 0.0
        if stuck.any():
            row = part.start + 1 + int(np.argmax(stuck))
            before, now = float(log.time[row - 1]), float(log.time[row])
            kind = "repeats" if before == now else "runs backwards"
            raise LogError(
                f"row {row}, time {kind}: {now!r} s after {before!r} s, it must increase",
                where=where,
                remedy="sort the rows and drop duplicates, or start a new segment where the clock restarted",
            )


def _check_load(log: MotorLog, where: str | Path | None) -> None:
    if log.load_inertia is not None and np.any(log.load_inertia <= 0.0):
        row, column = np.argwhere(log.load_inertia <= 0.0)[0].tolist()
        raise LogError(
            f"row {row}, {column_name('load_inertia', column, log.joint_names)} is "
            f"{log.load_inertia[row, column]} kg·m², it must be positive",
            where=where,
            remedy="give the load's inertia about the joint, or leave the channel out",
        )


def _check_gains(log: MotorLog, where: str | Path | None) -> None:
    if log.stated_kp is None and log.stated_kd is not None:
        raise LogError("stated_kd without stated_kp", where=where, remedy="state both, or the proportional gain alone")
    for name in ("stated_kp", "stated_kd"):
        gains = getattr(log, name)
        if gains is None:
            continue
        first = np.concatenate([np.full(part.stop - part.start, part.start) for part in log.segment_slices()])
        least = np.nextafter(0.0, 1.0) if name == "stated_kp" else 0.0
        for odd, problem in ((gains < least, "is too small"), (gains != gains[first], "changes within a segment")):
            if np.any(odd):
                row, column = np.argwhere(odd)[0].tolist()
                raise LogError(
                    f"row {row}, {column_name(name, column, log.joint_names)} {problem}: {gains[row, column]}",
                    where=where, remedy="begin a segment where gains change, or leave them out",
                )  # fmt: skip


def _check_conditions(log: MotorLog, where: str | Path | None) -> None:
    for name, (least, most) in CONDITIONS.items():
        values = getattr(log, name)
        if values is not None and np.any(odd := (values < least) | (values > most)):
            row, column = np.argwhere(odd)[0].tolist()
            raise LogError(
                f"row {row}, {column_name(name, column, log.joint_names)} is {values[row, column]:g} "
                f"{CONDITION_UNITS[name]}, not within {least:g}..{most:g}",
                where=where, remedy=f"give it in {CONDITION_UNITS[name]}, or leave the channel out",
            )  # fmt: skip


def _check_firmware(log: MotorLog, where: str | Path | None) -> None:
    for name, value in log.firmware.items():
        if name not in FIRMWARE:
            raise LogError(f"firmware {name!r}", where=where, remedy=f"give some of {', '.join(FIRMWARE)}")
        if not is_register(name, value):
            least, most = FIRMWARE[name]
            raise LogError(
                f"firmware.{name} {shown(value)} is not 0 (off) or a number within {least:g}..{most:g}", where=where,
                remedy="give it in rad, rad/s or rad/s², or leave it out",
            )  # fmt: skip


def _check_posture(log: MotorLog, where: str | Path | None) -> None:
    if log.posture is None:
        return
    unknown = np.flatnonzero((log.posture < 0) | (log.posture >= len(POSTURES)))
    if unknown.size:
        known = ", ".join(f"{code} {name}" for code, name in enumerate(POSTURES))
        raise LogError(
            f"row {unknown[0]}, posture {log.posture[unknown[0]]} is unknown",
            where=where,
            remedy=f"give one of: {known}",
        )
