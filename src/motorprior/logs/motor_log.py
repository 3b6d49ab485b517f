"""`MotorLog`: commands and measured motion of motors, in SI units, checked before use."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import LogError

JOINT_SERIES = {
    "position_target": "rad",
    "joint_pos": "rad",
    "joint_vel": "rad_per_s",
    "joint_torque": "N_m",
    "load_inertia": "kg_m2",
    "external_torque": "N_m",
    "load_stiffness": "N_m_per_rad",
    "stated_kp": "stated",
    "stated_kd": "stated",
}
"""Channels of shape (T, J) and their unit, as it is spelled in column names."""

BASE_AXES = ("roll", "pitch")
ENCODERS = ("joint", "rotor")
PHYSICAL_GAINS = "N·m/rad"
GAIN_UNITS = (PHYSICAL_GAINS, "firmware")
POSTURES = ("standing", "hung", "fixed", "fallen")
"""Of a robot: on its feet; base held in the air, feet free; bolted down; on its side or back. The channel `posture`
holds the place of one of them in this list."""
CODES = ("segment", "posture")
"""Channels of shape (T,) that are whole numbers."""
SIGN_CONVENTION = (
    "position error = position_target - joint_pos; a positive joint_torque accelerates joint_pos upwards; "
    "load_inertia * joint_acc = joint_torque + external_torque"
)


@dataclass(frozen=True, eq=False, kw_only=True)
class MotorLog:
    """One or more contiguous recordings of T rows and J joints.

    Construction checks nothing; `checked` does. A row holds the command in force and the measurements
    made at its time. With a known load (bench): load_inertia·q̈ = joint_torque + external_torque.

    Attributes:
        time: (T,) [s], strictly increasing within a segment.
        position_target: (T, J) commanded angle [rad].
        joint_pos: (T, J) measured angle [rad].
        joint_names: J names, in column order.
        robot: robot or bench the joints belong to.
        motor: motor model.
        source: where the log comes from.
        joint_vel: (T, J) [rad/s], or None.
        joint_torque: (T, J) torque of the motor on the joint [N·m], or None.
        load_inertia: (T, J) inertia of the known load, at the joint [kg·m²], or None.
        external_torque: (T, J) torque of everything but the motor on the joint [N·m], or None.
        load_stiffness: (T, J) change of external_torque with the joint's own angle, as that of gravity, at the recorded
            angle [N·m/rad], or None. A simulated joint gets external_torque + load_stiffness·(its angle - joint_pos).
        segment: (T,) index of the contiguous recording a row belongs to, or None for a single one.
        base_orientation: (T, 2) roll and pitch of the robot's base [rad], or None.
        posture: (T,) how the robot's base was held in a row, see POSTURES, or None where nobody said.
        encoder: where joint_pos and joint_vel are measured: "joint", or "rotor", to which the gear's play and wind-up
            are invisible (angles at the output shaft, too).
        stated_kp: (T, J) proportional gain that the motor was told, constant within a segment, or None.
        stated_kd: (T, J) the same for the derivative gain, which acts on the velocity; only with stated_kp.
        gain_unit: of the stated gains: "N·m/rad" (and N·m·s/rad), which are then the motor's, or "firmware", units of
            its own, of which the motor's gains are unknown multiples.
    """

    time: np.ndarray
    position_target: np.ndarray
    joint_pos: np.ndarray
    joint_names: tuple[str, ...]
    robot: str
    motor: str
    source: str
    joint_vel: np.ndarray | None = None
    joint_torque: np.ndarray | None = None
    load_inertia: np.ndarray | None = None
    external_torque: np.ndarray | None = None
    load_stiffness: np.ndarray | None = None
    segment: np.ndarray | None = None
    base_orientation: np.ndarray | None = None
    posture: np.ndarray | None = None
    encoder: str = "joint"
    stated_kp: np.ndarray | None = None
    stated_kd: np.ndarray | None = None
    gain_unit: str = PHYSICAL_GAINS

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.joint_names)

    @property
    def num_rows(self) -> int:
        """T."""
        return len(self.time)

    @property
    def duration(self) -> float:
        """Recorded time [s]: the sum over segments, without the pauses between them."""
        return float(sum(self.time[part][-1] - self.time[part][0] for part in self.segment_slices()))

    def segment_slices(self) -> list[slice]:
        """Rows of each segment, in order."""
        if self.segment is None:
            return [slice(0, self.num_rows)]
        starts = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *starts.tolist(), self.num_rows]
        return [slice(first, last) for first, last in pairwise(bounds)]

    def segments(self) -> Iterator[MotorLog]:
        """One log per contiguous recording; each keeps its `segment` index."""
        for part in self.segment_slices():
            yield self.rows(part)

    def rows(self, selection: slice | np.ndarray) -> MotorLog:
        """The rows a slice, a mask (T,) or an index array selects."""
        picked = {name: value[selection] for name, value in channels(self).items()}
        return replace(self, **picked)

    def joint(self, index: int) -> MotorLog:
        """The same log with one joint, J = 1."""
        series = {name: value[:, [index]] for name, value in channels(self).items() if name in JOINT_SERIES}
        return replace(self, joint_names=(self.joint_names[index],), **series)


def channels(log: MotorLog) -> dict[str, np.ndarray]:
    """Every array that the log holds, by field name."""
    values = {field.name: getattr(log, field.name) for field in fields(log)}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def time_steps(log: MotorLog) -> tuple[np.ndarray, np.ndarray]:
    """Row and length [s] of every step from the previous row of the same segment.

    Returns:
        ``rows`` (S,), the later row of each pair, and ``steps`` (S,) [s].
    """
    parts = log.segment_slices()
    rows = np.concatenate([np.arange(part.start + 1, part.stop) for part in parts])
    return rows, np.concatenate([np.diff(log.time[part]) for part in parts])


def stated_gain_rows(log: MotorLog) -> np.ndarray | None:
    """(2, T, J) stated kp and kd, kd equal to kp where it is not stated; None if none are."""
    if log.stated_kp is None:
        return None
    return np.stack([log.stated_kp, log.stated_kp if log.stated_kd is None else log.stated_kd])


def stated_gains_of(log: MotorLog) -> np.ndarray | None:
    """(2, J) medians of `stated_gain_rows` over segments, or None."""
    rows = stated_gain_rows(log)
    return None if rows is None else np.median(rows[:, [part.start for part in log.segment_slices()]], axis=1)


def log_digest(log: MotorLog) -> str:
    """SHA-256 of all that the log holds."""
    whole = hashlib.sha256()
    for field in fields(log):
        value = getattr(log, field.name)
        whole.update(f"{field.name} {getattr(value, 'shape', value)!r}\n".encode())
        if isinstance(value, np.ndarray):
            whole.update(np.ascontiguousarray(value).tobytes())
    return whole.hexdigest()


def column_name(channel: str, column: int, joint_names: tuple[str, ...]) -> str:
    """The name a user reads for one column of a channel, e.g. ``joint_pos/FR_hip``."""
    if channel in JOINT_SERIES:
        return f"{channel}/{joint_names[column]}"
    return f"{channel}/{BASE_AXES[column]}" if channel == "base_orientation" else channel


def checked(log: MotorLog, where: str | Path | None = None) -> MotorLog:
    """Return the log with float64 arrays, or say what is wrong with it.

    Args:
        log: any channel may be any array-like; rows count from 0.
        where: file to name in the error.

    Raises:
        LogError: wrong shape or joint count, a value that is not finite (row, column, value), time that
            does not increase within a segment (row, both values), a load inertia that is not positive,
            fewer than 2 rows in a segment, an unknown posture, place of the encoder or unit of gains, or stated gains
            that change within a segment, or that are not positive (kd: negative).
    """
    if log.encoder not in ENCODERS:
        raise LogError(f"encoder {log.encoder!r}", where=where, remedy=f"give {' or '.join(ENCODERS)}")
    if log.gain_unit not in GAIN_UNITS:
        raise LogError(f"gain_unit {log.gain_unit!r}", where=where, remedy=f"give {' or '.join(GAIN_UNITS)}")
    log = _as_arrays(log, where)
    _check_shapes(log, where)
    _check_finite(log, where)
    _check_segments(log, where)
    _check_time(log, where)
    _check_load(log, where)
    _check_gains(log, where)
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
