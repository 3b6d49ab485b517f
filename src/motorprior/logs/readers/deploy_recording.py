"""Recordings of `record` and `deploy`: CSV with one line per accepted frame of telemetry.

The last line may be cut if the writer was killed; it is then ignored. Times are of the clock of the
robot.
"""

from enum import IntEnum
from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.log_reader import LogReader, require_robot
from motorprior.logs.motor_log import (
    MIN_ROWS,
    MotorLog,
    checked,
    require_finite,
    require_increasing,
)
from motorprior.logs.readers.table import csv_names, table_columns
from motorprior.robots.robot import Robot
from motorprior.signals import mean_command

# a longer pause starts a new segment; single lost frames do not [s]
_GAP = 0.055
_SERIES = ("position_target", "joint_pos", "joint_vel", "joint_current")
_BODY = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


class Mode(IntEnum):
    """Activity of the robot."""

    RAMP = 1
    WALK = 2
    EXCITE = 3
    CROUCH = 4


def run_columns(joint_names: tuple[str, ...], with_current: bool) -> tuple[str, ...]:
    """Column names: time, mode, start time of the target in force, series per joint, body.

    Values are in s, rad, rad/s and A.
    """
    series = _SERIES if with_current else _SERIES[:-1]
    joint_columns = [f"{name}/{joint}" for name in series for joint in joint_names]
    return ("time", "mode", "target_since", *joint_columns, *_BODY)


def read_deploy_recording(
    path: Path,
    robot: Robot,
    modes: tuple[Mode, ...] = (Mode.WALK, Mode.EXCITE),
    period: float | None = None,
) -> MotorLog:
    """Read the rows of a recording with certain activities.

    A pause, or another activity, starts a new segment; segments of fewer than 4 rows are dropped.
    If the robot sent currents, joint_torque = current · torque constant: the motor's own estimate,
    without gear friction. With a ``period`` [s], every segment is put on this grid: angles by cubic
    splines, velocities as their derivatives, and as command the mean of the targets in force during
    each step.

    Raises:
        LogError: another or damaged file, no row of these activities, or a period longer than a
            segment.
    """
    joints = robot.num_joints
    has_current = any(name.startswith("joint_current/") for name in csv_names(path))
    columns = run_columns(robot.joint_names, has_current)
    table = np.column_stack(list(table_columns(path, columns, may_be_cut=True).values()))
    require_finite(table, list(columns), path)
    require_increasing(table[:, 0], path)

    segments = _segments_of(table, modes, path)
    if period is not None:
        segments = [_on_grid(segment, period, joints) for segment in segments]
    table = np.concatenate(segments)

    *series, base = np.split(table[:, 3:], range(joints, len(columns) - 3, joints), axis=1)
    torque = robot.require_wire().torque_constant * series[3] if has_current else None
    log = MotorLog(
        time=table[:, 0],
        position_target=series[0],
        joint_pos=series[1],
        joint_vel=series[2],
        joint_torque=torque,
        segment=np.repeat(np.arange(len(segments)), [len(segment) for segment in segments]),
        base_orientation=base[:, :2],
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=str(path),
        encoder=robot.encoder,
    )
    return checked(log)


def _segments_of(table: np.ndarray, modes: tuple[Mode, ...], path: Path) -> list[np.ndarray]:
    """Rows of each segment of these activities."""
    begins = np.diff(table[:, 0], prepend=-np.inf) > _GAP
    begins |= np.diff(table[:, 1], prepend=0.0) != 0.0
    segment = np.cumsum(begins)

    rows = np.isin(table[:, 1], modes) & (np.bincount(segment)[segment] >= MIN_ROWS)
    if not rows.any():
        names = " or ".join(mode.name.lower() for mode in modes)
        raise LogError(
            f"no row of mode {names}",
            where=path,
            remedy="give a recording of at least a second of it",
        )
    return [table[rows & (segment == index)] for index in np.unique(segment[rows])]


def _on_grid(segment: np.ndarray, period: float, joints: int) -> np.ndarray:
    """One segment on a grid of ``period`` [s]."""
    from scipy.interpolate import CubicSpline  # takes half a second

    time = segment[:, 0]
    num_rows = int((time[-1] - time[0]) / period + 1e-6) + 1
    grid = time[0] + period * np.arange(num_rows)

    since = np.maximum.accumulate(segment[:, 2])
    since[0] = min(since[0], time[0])  # the first target is assumed to hold before, too
    in_force = np.maximum(0, np.searchsorted(since, grid, side="right") - 1)
    targets = mean_command(since, segment[:, 3 : 3 + joints], grid, period)

    spline = CubicSpline(time, segment[:, 3 + joints :], axis=0)
    table = np.column_stack([grid, segment[in_force, 1:3], targets, spline(grid)])
    table[:, 3 + 2 * joints : 3 + 3 * joints] = spline(grid, 1)[:, :joints]
    return table


def _is_recording(path: Path) -> bool:
    return csv_names(path)[:2] == ["time", "mode"]


def _read(path: Path, robot: Robot | None) -> MotorLog:
    return read_deploy_recording(path, require_robot(robot, path))


def _read_on_grid(path: Path, robot: Robot | None, period: float, suspended: bool) -> MotorLog:
    modes = (Mode.EXCITE,) if suspended else (Mode.WALK, Mode.EXCITE)
    return read_deploy_recording(path, require_robot(robot, path), modes, period)


READER = LogReader(
    "recording of a robot",
    (".csv",),
    _is_recording,
    _read,
    on_grid=_read_on_grid,
    needs_robot=True,
)
