"""Recordings of servos as `hardware.servo_recorder` writes them, without hardware."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.logs.readers.deploy_recording import Mode
from motorprior.logs.readers.servo_recording import HEADING, VERSION, servo_columns

JOINTS = ("pan", "lift")


def header(**changes: Any) -> dict[str, Any]:
    """The header of a recording of two joints of an arm."""
    content = {
        "version": VERSION,
        "robot": "arm",
        "motor": "Feetech STS3215",
        "posture": "fixed",
        "encoder": "joint",
        "joint_names": list(JOINTS),
        "joint_classes": list(JOINTS),
        "p_gains": [16, 32],
        "firmware": {"profile_acceleration": 39.0, "dead_zone": 0.0},
        "units": {"load": "0.1 %", "current": "6.5 mA"},
        "servos": [{"id": 1}, {"id": 2}],
        "settings": {},
    }
    return content | changes


def write_servo_recording(
    folder: Path,
    *,
    rows: int = 40,
    period: float = 0.004,
    write_delay: float = 0.001,
    parts: int = 2,
    end: str = "",
    **changes: Any,
) -> Path:
    """Write a recording whose command and angle are 0.1·sin(10·t) at the times of their rows.

    The target in force at a row was written ``write_delay`` after the row before it. ``end`` is
    appended.
    """
    content = header(**changes)
    names = tuple(content["joint_names"])
    lines = [HEADING + json.dumps(content), ",".join(servo_columns(names))]
    for row in range(rows):
        time = row * period
        part = row * parts // rows
        angle = 0.1 * np.sin(10.0 * time)
        target = 0.1 * np.sin(10.0 * (time - period))
        clocks = [time, int(Mode.EXCITE), part, time - 5e-4, time + 5e-4]
        series = [target, angle, 0.0, 5.0, 3.0, 12.0, 30.0]
        values = [*clocks, time - period + write_delay]
        values += [value for value in series for _ in names]
        lines.append(",".join(f"{value:.9g}" for value in values))
    path = folder / "run.servolog"
    path.write_text("\n".join(lines) + "\n" + end)
    return path
