"""Recordings of a robot, one CSV line per believed frame of telemetry: what they hold, and how they become a log.

A line is complete or, at the very end of a file whose writer was killed, cut: then it does not count. Time is the
robot's own clock. A row holds the command in force and the measurements made at its time, as in any `MotorLog`.
"""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.logs.number_table import read_number_table
from motorprior.robots.pupper_v2.spec import JOINT_NAMES, ROBOT_NAME, TORQUE_CONSTANT

MOTOR = "DJI M2006 P36 + C610"
_GAP = 0.055
"""A pause longer than this [s] starts a new segment; single lost frames do not."""
_SERIES = ("position_target", "joint_pos", "joint_vel", "joint_current")
_BODY = ("roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate")


class Mode(IntEnum):
    """What the robot was doing in a row."""

    RAMP = 1
    WALK = 2
    EXCITE = 3
    CROUCH = 4


def run_columns(with_current: bool) -> tuple[str, ...]:
    """Names of the columns: ``time`` [s], ``mode``, four series [rad, rad, rad/s, A] per joint, body [rad, rad/s]."""
    series = _SERIES if with_current else _SERIES[:-1]
    return ("time", "mode", *(f"{name}/{joint}" for name in series for joint in JOINT_NAMES), *_BODY)


def is_robot_run(path: Path) -> bool:
    """Whether a file begins like a recording of a robot."""
    try:
        with open(path, "rb") as file:
            return file.read(10) == b"time,mode,"
    except OSError:
        return False


def read_robot_run(path: Path, modes: tuple[Mode, ...] = (Mode.WALK, Mode.EXCITE)) -> MotorLog:
    """The rows of a recording in which the motors worked.

    A pause, or another mode, starts a new segment; segments of one row are left out. Where the robot sent
    currents, joint_torque = current · torque constant, the motor's own estimate: friction in the gear is not in it.

    Raises:
        LogError: not a recording, damaged before its last line, or without a row of these modes.
    """
    with open(path, encoding="utf-8", errors="replace") as file:
        with_current = "joint_current/" in file.readline()
    columns = run_columns(with_current)
    table = read_number_table(path, columns, may_be_cut=True)
    wanted = np.isin(table[:, 1], modes)
    time = table[:, 0]
    breaks = np.diff(time, prepend=-np.inf) > _GAP
    breaks |= np.diff(table[:, 1], prepend=0.0) != 0.0
    segment = np.cumsum(breaks)
    alone = np.bincount(segment)[segment] < 2
    rows = wanted & ~alone
    if not rows.any():
        raise LogError(
            "no row in which the robot walked or was excited", where=path, remedy="record longer, or give another file"
        )
    joints = len(JOINT_NAMES)
    series = {name: table[rows, 2 + index * joints : 2 + (index + 1) * joints] for index, name in enumerate(_SERIES)}
    log = MotorLog(
        time=time[rows],
        position_target=series["position_target"],
        joint_pos=series["joint_pos"],
        joint_vel=series["joint_vel"],
        joint_torque=TORQUE_CONSTANT * series["joint_current"] if with_current else None,
        segment=np.unique(segment[rows], return_inverse=True)[1].astype(np.int64),
        base_orientation=table[rows, columns.index("roll") : columns.index("roll") + 2],
        joint_names=JOINT_NAMES,
        robot=ROBOT_NAME,
        motor=MOTOR,
        source=str(path),
    )
    return checked(log, where=path)
