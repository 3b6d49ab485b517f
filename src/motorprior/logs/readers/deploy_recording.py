"""Recordings of `record` and `deploy`: CSV with one line per accepted frame of telemetry.

The last line may be cut if the writer was killed; it is then ignored. Time is the robot's own
clock.
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

_GAP = 0.055  # a pause longer than this [s] starts a new segment; single lost frames do not
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
    return (
        "time",
        "mode",
        "target_since",
        *(f"{name}/{joint}" for name in series for joint in joint_names),
        *_BODY,
    )


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

    Raises LogError for another or damaged file, no row of these activities, or a period longer than
    a segment.
    """
    columns = run_columns(
        robot.joint_names, any(name.startswith("joint_current/") for name in csv_names(path))
    )
    table = np.column_stack(list(table_columns(path, columns, may_be_cut=True).values()))
    require_finite(table, list(columns), path)
    require_increasing(table[:, 0], path)
    breaks = np.diff(table[:, 0], prepend=-np.inf) > _GAP
    breaks |= np.diff(table[:, 1], prepend=0.0) != 0.0
    segment = np.cumsum(breaks)
    rows = np.isin(table[:, 1], modes) & (np.bincount(segment)[segment] >= MIN_ROWS)
    if not rows.any():
        wanted = " or ".join(mode.name.lower() for mode in modes)
        raise LogError(
            f"no row of mode {wanted}",
            where=path,
            remedy="give a recording of at least a second of it",
        )
    parts = [table[rows & (segment == index)] for index in np.unique(segment[rows])]
    if period is not None:
        parts = [_on_grid(part, period, robot.num_joints) for part in parts]
    table = np.concatenate(parts)
    joints = robot.num_joints
    *series, body = np.split(table[:, 3:], range(joints, len(columns) - 3, joints), axis=1)
    current = series[3] if len(series) > 3 else None
    log = MotorLog(
        time=table[:, 0],
        position_target=series[0],
        joint_pos=series[1],
        joint_vel=series[2],
        joint_torque=None if current is None else robot.require_wire().torque_constant * current,
        segment=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        base_orientation=body[:, :2],
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=str(path),
        encoder=robot.encoder,
    )
    return checked(log)


def _on_grid(part: np.ndarray, period: float, joints: int) -> np.ndarray:
    """One segment on a grid of ``period`` [s]."""
    from scipy.interpolate import CubicSpline  # takes half a second

    time = part[:, 0]
    grid = time[0] + period * np.arange(int((time[-1] - time[0]) / period + 1e-6) + 1)
    since = np.maximum.accumulate(part[:, 2])
    since[0] = min(since[0], time[0])  # the first target is assumed to hold before, too
    in_force = np.maximum(0, np.searchsorted(since, grid, side="right") - 1)
    spline = CubicSpline(time, part[:, 3 + joints :], axis=0)
    targets = mean_command(since, part[:, 3 : 3 + joints], grid, period)
    out = np.column_stack([grid, part[in_force, 1:3], targets, spline(grid)])
    out[:, 3 + 2 * joints : 3 + 3 * joints] = spline(grid, 1)[:, :joints]
    return out


READER = LogReader(
    "recording of a robot",
    (".csv",),
    lambda path: csv_names(path)[:2] == ["time", "mode"],
    lambda path, robot: read_deploy_recording(path, require_robot(robot, path)),
    on_grid=lambda path, robot, period, suspended: read_deploy_recording(
        path,
        require_robot(robot, path),
        (Mode.EXCITE,) if suspended else (Mode.WALK, Mode.EXCITE),
        period,
    ),
    needs_robot=True,
)
