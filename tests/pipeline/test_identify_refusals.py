"""What no fit can make better is refused before it, with a way out; what only a fit shows, after it."""


import numpy as np
import pytest

from motorprior.logs.motor_log import MotorLog


@pytest.fixture
def log() -> MotorLog:
    """A joint that follows its command a little late."""
    time = 0.002 * np.arange(900)
    angle = np.sin(9.0 * time)[:, None]
    return MotorLog(
        time=time, position_target=angle + 0.01, joint_pos=angle, joint_names=("j",), robot="r", motor="m",
        source="mine.parquet", load_inertia=np.full_like(angle, 0.01), external_torque=0.0 * angle,
    )  # fmt: skip
