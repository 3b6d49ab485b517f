"""Recordings of `record` and `deploy`: CSV with one line per accepted frame of telemetry.

The last line may be cut if the writer was killed; it is then ignored. Time is the robot's own clock.
"""

from __future__ import annotations

import re
from enum import IntEnum
from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.formats.csv_table import read_number_table
from motorprior.logs.formats.log_reader import LogReader, require_robot
from motorprior.logs.log_errors import require_finite, require_increasing
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

_GAP = 0.055  # a pause longer than this [s] starts a new segment; single lost frames do not
_MIN_ROWS = 4  # of a segment
_SERIES = ("position_target", "joint_pos", "joint_vel", "joint_current")
_BODY = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


class Mode(IntEnum):
    """Activity of the robot."""

    RAMP = 1
    WALK = 2
    EXCITE = 3
    CROUCH = 4


def run_columns(joint_names: tuple[str, ...], with_current: bool) -> tuple[str, ...]:
    """Column names: time, mode, start time of the target in force, series per joint, body; s, rad, rad/s and A."""
    series = _SERIES if with_current else _SERIES[:-1]
    return ("time", "mode", "target_since", *(f"{name}/{joint}" for name in series for joint in joint_names), *_BODY)


def _first_line(path: Path) -> str:
    """The column names; of a file without lines, its beginning."""
    try:
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            return file.readline(10_000)
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path, remedy="check the path") from error


def read_robot_run(
    path: Path, robot: Robot, modes: tuple[Mode, ...] = (Mode.WALK, Mode.EXCITE), period: float | None = None
) -> MotorLog:
    """Read the rows of a recording with certain activities.

    A pause, or another activity, starts a new segment; segments of fewer than 4 rows are dropped. If the robot sent
    currents, joint_torque = current · torque constant: the motor's own estimate, without gear friction.

    Args:
        path: the recording.
        robot: the recorded robot.
        modes: activities of the rows to read.
        period: put every segment on this grid [s]: angles by cubic splines, velocities as their derivatives, and as
            command the mean of the targets in force during each step. As recorded if not given.

    Raises:
        LogError: not a recording, damaged before its last line, no row of these activities, time that does not
            increase, or numbers that are not finite.
    """
    columns = run_columns(robot.joint_names, with_current="joint_current/" in _first_line(path))
    table = read_number_table(path, columns, may_be_cut=True)
    require_finite(table, list(columns), path)
    require_increasing(table[:, 0], path)
    breaks = np.diff(table[:, 0], prepend=-np.inf) > _GAP
    breaks |= np.diff(table[:, 1], prepend=0.0) != 0.0
    segment = np.cumsum(breaks)
    long_enough = np.bincount(segment)[segment] >= _MIN_ROWS
    rows = np.isin(table[:, 1], modes) & long_enough
    if not rows.any():
        wanted = " or ".join(mode.name.lower() for mode in modes)
        raise LogError(f"no row of mode {wanted}", where=path, remedy="give a recording of at least a second of it")
    parts = [table[rows & (segment == index)] for index in np.unique(segment[rows])]
    if period is not None:
        parts = [_on_grid(part, period, robot.num_joints, path) for part in parts]
    return checked(_as_log(parts, columns, robot, path), where=path)


def _as_log(parts: list[np.ndarray], columns: tuple[str, ...], robot: Robot, path: Path) -> MotorLog:
    table, joints = np.concatenate(parts), robot.num_joints
    series = {name: table[:, 3 + index * joints : 3 + (index + 1) * joints] for index, name in enumerate(_SERIES)}
    with_current = any(column.startswith("joint_current/") for column in columns)
    roll = columns.index("roll")
    return MotorLog(
        time=table[:, 0], position_target=series["position_target"], joint_pos=series["joint_pos"],
        joint_vel=series["joint_vel"],
        joint_torque=robot.require_wire().torque_constant * series["joint_current"] if with_current else None,
        segment=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        base_orientation=table[:, roll : roll + 2], joint_names=robot.joint_names, robot=robot.name, motor=robot.motor,
        source=str(path), encoder=robot.encoder,
    )  # fmt: skip


def _on_grid(part: np.ndarray, period: float, joints: int, path: Path) -> np.ndarray:
    """One segment on a grid of ``period`` [s]."""
    from scipy.interpolate import CubicSpline

    time = part[:, 0]
    if not 0.0 < period <= time[-1] - time[0]:
        raise LogError(f"period {period:g} s is longer than a segment of {time[-1] - time[0]:g} s", where=path)
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    targets, angles = slice(3, 3 + joints), slice(3 + joints, 3 + 2 * joints)
    spline = CubicSpline(time, part[:, 3 + joints :], axis=0)
    since = np.maximum.accumulate(part[:, 2])
    since[0] = min(since[0], time[0])  # the first target is assumed to hold before, too
    in_force = np.maximum(0, np.searchsorted(since, grid, side="right") - 1)
    means = _means_of_steps(since, part[:, targets], grid, period)
    out = np.column_stack([grid, part[in_force, 1:3], means, spline(grid)])
    out[:, 3 + 2 * joints : 3 + 3 * joints] = CubicSpline(time, part[:, angles], axis=0)(grid, 1)
    return out


def _means_of_steps(since: np.ndarray, targets: np.ndarray, grid: np.ndarray, period: float) -> np.ndarray:
    """(steps, joints) mean over each grid step of targets that are in force ``since`` their times."""
    since = np.append(since, np.maximum(since[-1], grid[-1] + period))
    sums = np.vstack([np.zeros_like(targets[:1]), np.cumsum(np.diff(since)[:, None] * targets, axis=0)])
    bounds = np.append(grid, grid[-1] + period)
    at_bounds = np.stack([np.interp(bounds, since, column) for column in sums.T], axis=1)
    return np.diff(at_bounds, axis=0) / period


ROBOT_RUN = LogReader(
    "recording of a robot",
    (".csv",),
    lambda path: re.match(r"time([,;\t])mode\1", _first_line(path)) is not None,
    lambda path, robot: read_robot_run(path, require_robot(robot, path)),
)
