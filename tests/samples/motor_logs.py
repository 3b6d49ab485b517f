"""Motor logs in memory, tables of them, and what the log doctor finds."""

from pathlib import Path
from typing import Any

import numpy as np

from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

TABLE_MAP = (
    'motor = "servo"\ntime = "t"\nposition_target = "goal_{joint}"\njoint_pos = "pos_{joint}"\n'
)
"""Of the tables of `write_table`, without joints."""


def log_of(
    time: np.ndarray, target: np.ndarray, pos: np.ndarray | None = None, /, **fields: Any
) -> MotorLog:
    """Joints a, b, … with (N,) or (N, J) targets and angles, which are the targets if not given; or other fields."""
    columns = [
        np.reshape(each, (len(time), -1)) for each in (target, target if pos is None else pos)
    ]
    names = tuple("abcdef"[: columns[0].shape[1]])
    known = {"joint_names": names, "robot": "r", "motor": "m", "source": "made"}
    return MotorLog(
        **(known | {"time": time, "position_target": columns[0], "joint_pos": columns[1]} | fields)
    )


def joints_of(robot: Robot) -> dict[str, Any]:
    """Fields of a log of this robot."""
    return {"joint_names": robot.joint_names, "robot": robot.name, "motor": robot.motor}


def swinging_load(rows: int = 400, /, **stated: Any) -> MotorLog:
    """A joint that swings a known load: a sine at 500 Hz, its target 10 mrad ahead, and what the log states besides."""
    time = 0.002 * np.arange(rows)
    angle = np.sin(9.0 * time)[:, None]
    load = {"load_inertia": np.full_like(angle, 0.01), "external_torque": 0.0 * angle}
    return log_of(time, angle + 0.01, angle, **load, **stated)


def write_table(log: MotorLog, path: Path, second: float = 1.0, radian: float = 1.0) -> Path:
    """A CSV of time, targets and angles, with these numbers for a second and a radian."""
    names = [f"{what}_{joint}" for what in ("goal", "pos") for joint in log.joint_names]
    rows = np.column_stack(
        [second * log.time, radian * log.position_target, radian * log.joint_pos]
    )
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *names]), comments="")
    return path


def of_check(report: LogReport, check: str) -> list[Finding]:
    """Findings of one check."""
    return [finding for finding in report.findings if finding.check == check]
