"""A log of one joint that swings a known load."""

from typing import Any

import numpy as np

from motorprior.logs.motor_log import MotorLog


def swinging_load(rows: int = 400, /, **stated: Any) -> MotorLog:
    """A sine at 500 Hz, its command 10 mrad ahead, and what the log states besides."""
    time = 0.002 * np.arange(rows)
    angle = np.sin(9.0 * time)[:, None]
    load = {"load_inertia": np.full_like(angle, 0.01), "external_torque": 0.0 * angle}
    return MotorLog(
        time=time, position_target=angle + 0.01, joint_pos=angle, joint_names=("j",), robot="r", motor="m", source="s",
        **load, **stated,
    )  # fmt: skip
