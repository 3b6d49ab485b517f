"""Recordings of a robot, one CSV line per accepted frame of telemetry: what they hold, and how they become a log.

A line is complete or, at the very end of a file whose writer was killed, cut: then it does not count. Time is the
robot's own clock. A row holds the command in force and the measurements made at its time, as in any `MotorLog`.
"""

from __future__ import annotations

import re
from enum import IntEnum
from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.csv_table import read_number_table
from motorprior.logs.formats.log_reader import LogReader, require_given
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

_GAP = 0.055
"""A pause longer than this [s] starts a new segment; single lost frames do not."""
_SHORTEST_SEGMENT = 4
_LONGEST_HEADER = 10_000
_SERIES = ("position_target", "joint_pos", "joint_vel", "joint_current")
_BODY = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


class Mode(IntEnum):
    """The robot's activity in a row."""

    RAMP = 1
    WALK = 2
    EXCITE = 3
    CROUCH = 4


_DOING = {Mode.RAMP: "stood up", Mode.WALK: "walked", Mode.EXCITE: "was excited", Mode.CROUCH: "sat down"}


def run_columns(joint_names: tuple[str, ...], with_current: bool) -> tuple[str, ...]:
    """Names of the columns: time, mode, when the target in force came into force, series per joint, body.

    Units: s, rad, rad/s and, for joint_current, A; both times on the robot's clock.
    """
    series = _SERIES if with_current else _SERIES[:-1]
    return ("time", "mode", "target_since", *(f"{name}/{joint}" for name in series for joint in joint_names), *_BODY)


def is_robot_run(path: Path) -> bool:
    """Whether a file begins like a recording of a robot.

    Raises:
        LogError: it cannot be read.
    """
    return re.match(r"time([,;\t])mode\1", _first_line(path)) is not None


def _first_line(path: Path) -> str:
    """The names of the columns; of a file that has no lines, its beginning."""
    try:
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            return file.readline(_LONGEST_HEADER)
    except OSError as error:
        raise LogError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def read_robot_run(
    path: Path, robot: Robot, modes: tuple[Mode, ...] = (Mode.WALK, Mode.EXCITE), period: float | None = None
) -> MotorLog:
    """The rows of a recording in which the robot walked or was excited, or did what ``modes`` say.

    A pause, or another mode, starts a new segment; segments of fewer than 4 rows are left out. Where the robot sent
    currents, joint_torque = current · torque constant: the motor's own estimate, without the friction of its gear.

    Args:
        path: the recording.
        robot: that was recorded.
        modes: what the robot must have been doing.
        period: put every segment on this grid [s]: angles by cubic splines, velocities as their derivatives, and in
            every step the mean of the targets in force in it, so that none is late or early. As recorded if not given.

    Raises:
        LogError: not a recording, damaged before its last line, without a row of these modes, a time that does not
            increase, or numbers that are not finite.
    """
    columns = run_columns(robot.joint_names, with_current="joint_current/" in _first_line(path))
    table = read_number_table(path, columns, may_be_cut=True)
    _require_clean(table, columns, path)
    breaks = np.diff(table[:, 0], prepend=-np.inf) > _GAP
    breaks |= np.diff(table[:, 1], prepend=0.0) != 0.0
    segment = np.cumsum(breaks)
    long_enough = np.bincount(segment)[segment] >= _SHORTEST_SEGMENT
    rows = np.isin(table[:, 1], modes) & long_enough
    if not rows.any():
        wanted = " or ".join(_DOING[mode] for mode in modes)
        raise LogError(
            f"no row in which the robot {wanted}", where=path, remedy="give a recording in which it did, for a second"
        )
    parts = [table[rows & (segment == index)] for index in np.unique(segment[rows])]
    if period is not None:
        parts = [_on_grid(part, period, robot.num_joints, path) for part in parts]
    return checked(_as_log(parts, columns, robot, path), where=path)


def _require_clean(table: np.ndarray, columns: tuple[str, ...], path: Path) -> None:
    """Refuse numbers that are not finite and times that do not increase, with the row of the file."""
    remedy = "delete the row, or copy the file again from the robot"
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        problem = f"row {row}, {columns[column]} is {table[row, column]}, not a finite number"
        raise LogError(problem, where=path, remedy=remedy)
    if (stuck := np.flatnonzero(np.diff(table[:, 0]) <= 0.0)).size:
        before, now = table[stuck[0] : stuck[0] + 2, 0]
        problem = f"row {stuck[0] + 1}: time {now:.3f} s does not increase after {before:.3f} s"
        raise LogError(problem, where=path, remedy=remedy)


def _as_log(parts: list[np.ndarray], columns: tuple[str, ...], robot: Robot, path: Path) -> MotorLog:
    table, joints = np.concatenate(parts), robot.num_joints
    series = {name: table[:, 3 + index * joints : 3 + (index + 1) * joints] for index, name in enumerate(_SERIES)}
    with_current = any(column.startswith("joint_current/") for column in columns)
    roll = columns.index("roll")
    return MotorLog(
        time=table[:, 0],
        position_target=series["position_target"],
        joint_pos=series["joint_pos"],
        joint_vel=series["joint_vel"],
        joint_torque=robot.require_wire().torque_constant * series["joint_current"] if with_current else None,
        segment=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        base_orientation=table[:, roll : roll + 2],
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=str(path),
        encoder=robot.encoder,
    )


def _on_grid(part: np.ndarray, period: float, joints: int, path: Path) -> np.ndarray:
    """The rows of one segment every ``period`` [s]."""
    from scipy.interpolate import CubicSpline

    time = part[:, 0]
    if not 0.0 < period <= time[-1] - time[0]:
        raise LogError(f"period {period:g} s does not fit a segment of {time[-1] - time[0]:g} s", where=path)
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    targets, angles = slice(3, 3 + joints), slice(3 + joints, 3 + 2 * joints)
    spline = CubicSpline(time, part[:, 3 + joints :], axis=0)
    since = np.maximum.accumulate(part[:, 2])
    since[0] = min(since[0], time[0])  # before a target is known the first one holds
    in_force = np.maximum(0, np.searchsorted(since, grid, side="right") - 1)
    means = _means_of_steps(since, part[:, targets], grid, period)
    out = np.column_stack([grid, part[in_force, 1:3], means, spline(grid)])
    out[:, 3 + 2 * joints : 3 + 3 * joints] = CubicSpline(time, part[:, angles], axis=0)(grid, 1)
    return out


def _means_of_steps(since: np.ndarray, targets: np.ndarray, grid: np.ndarray, period: float) -> np.ndarray:
    """(steps, joints) means, from each time of the grid to the next, of targets that hold ``since`` their times."""
    since = np.append(since, np.maximum(since[-1], grid[-1] + period))
    sums = np.vstack([np.zeros_like(targets[:1]), np.cumsum(np.diff(since)[:, None] * targets, axis=0)])
    bounds = np.append(grid, grid[-1] + period)
    at_bounds = np.stack([np.interp(bounds, since, column) for column in sums.T], axis=1)
    return np.diff(at_bounds, axis=0) / period


ROBOT_RUN = LogReader(
    "recording of a robot",
    (".csv",),
    is_robot_run,
    lambda path, robot: read_robot_run(path, require_given(robot, path)),
)
