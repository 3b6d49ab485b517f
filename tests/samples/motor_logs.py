"""Motor logs in memory, tables of them, and findings of the log doctor."""

from pathlib import Path
from typing import Any

import numpy as np

from motorprior.logs.doctor.findings import Finding, LogReport
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import Robot

TABLE_MAP = (
    'motor = "servo"\ntime = "t"\nposition_target = "goal_{joint}"\njoint_pos = "pos_{joint}"\n'
)
"""Column map of the tables of `write_table`, without joints."""


def log_of(
    time: np.ndarray, target: np.ndarray, pos: np.ndarray | None = None, /, **fields: Any
) -> MotorLog:
    """Log of joints a, b, … with (N,) or (N, J) targets and angles.

    Without angles, the joints are at their targets. ``fields`` are further fields of `MotorLog`.
    """
    targets = np.reshape(target, (len(time), -1))
    angles = np.reshape(target if pos is None else pos, (len(time), -1))
    made = {
        "joint_names": tuple("abcdef"[: targets.shape[1]]),
        "robot": "r",
        "motor": "m",
        "source": "made",
        "time": time,
        "position_target": targets,
        "joint_pos": angles,
    }
    return MotorLog(**(made | fields))


def joints_of(robot: Robot) -> dict[str, Any]:
    """Fields of a log of this robot."""
    return {"joint_names": robot.joint_names, "robot": robot.name, "motor": robot.motor}


def swinging_load(rows: int = 400, /, **stated: Any) -> MotorLog:
    """Log at 500 Hz of a joint that swings a known load in a sine, its target 10 mrad ahead.

    ``stated`` are further fields of `MotorLog`.
    """
    time = 0.002 * np.arange(rows)
    angle = np.sin(9.0 * time)[:, None]
    load = {"load_inertia": np.full_like(angle, 0.01), "external_torque": 0.0 * angle}
    return log_of(time, angle + 0.01, angle, **load, **stated)


def write_table(log: MotorLog, path: Path, second: float = 1.0, radian: float = 1.0) -> Path:
    """Path of a CSV of time, targets and angles; ``second`` and ``radian`` are its units."""
    names = [f"{what}_{joint}" for what in ("goal", "pos") for joint in log.joint_names]
    rows = np.column_stack(
        [second * log.time, radian * log.position_target, radian * log.joint_pos]
    )
    np.savetxt(path, rows, delimiter=",", header=",".join(["t", *names]), comments="")
    return path


def of_check(report: LogReport, check: str) -> list[Finding]:
    """Findings of one check."""
    return [finding for finding in report.findings if finding.check == check]
