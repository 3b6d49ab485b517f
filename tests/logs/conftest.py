"""Small logs made from a seed, and the real ones."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from motor_logs import log_of

from motorprior.logs.motor_log import MotorLog


@pytest.fixture
def make_log() -> Callable[..., MotorLog]:
    """A bench log of 2 joints that follow a sine 50 ms late; fields can be replaced."""

    def make(rows: int = 200, period: float = 0.01, **changes: Any) -> MotorLog:
        time = period * np.arange(rows) + 0.25
        phase_of_joint = np.array([0.0, 1.0])  # rad

        # 0.3 rad at 1 Hz
        phase = 2 * np.pi * time[:, None] + phase_of_joint
        late_phase = 2 * np.pi * (time[:, None] - 0.05) + phase_of_joint
        target = 0.3 * np.sin(phase)
        angle = 0.3 * np.sin(late_phase)
        speed = 0.3 * 2 * np.pi * np.cos(late_phase)

        fields = {"joint_vel": speed, "joint_names": ("left", "right")} | changes

        return log_of(time, target, angle, **fields)

    return make


@pytest.fixture
def rich_log() -> MotorLog:
    """A good bench log: 12 s of 2 joints that follow sums of sines 50 ms late, on known loads."""
    time = 0.01 * np.arange(1200)
    sines = ((0.3, 0.4), (0.15, 1.1), (0.06, 2.7))  # amplitude [rad], frequency [Hz]

    def motion(late: float, order: int) -> np.ndarray:
        """Derivative of the motion, ``late`` [s] behind the command; order 0 is the angle."""
        motion = np.zeros((len(time), 2))
        for amplitude, frequency in sines:
            rate = 2 * np.pi * frequency
            # each derivative turns the phase by a quarter
            phase = rate * (time[:, None] - late) + [0.0, 1.0] + np.pi / 2 * order
            motion = motion + amplitude * rate**order * np.sin(phase)

        return motion

    inertia = np.full((len(time), 2), 0.004)
    external = -0.3 * np.sin(motion(0.05, 0))

    return log_of(
        time,
        motion(0.0, 0),
        motion(0.05, 0),
        joint_vel=motion(0.05, 1),
        joint_names=("left", "right"),
        joint_torque=inertia * motion(0.05, 2) - external,
        load_inertia=inertia,
        external_torque=external,
    )


@pytest.fixture
def full_log(make_log: Callable[..., MotorLog]) -> MotorLog:
    """Every optional channel, two segments, values that decimal text would not keep."""
    rng = np.random.default_rng(3)
    first = np.cumsum(rng.uniform(1e-3, 2e-3, 100))
    second = np.cumsum(rng.uniform(1e-3, 2e-3, 100))
    time = np.concatenate([first, second])

    return make_log(
        time=time,
        joint_torque=rng.normal(size=(200, 2)) * 1e-300,
        load_inertia=rng.uniform(1e-4, 1e-2, (200, 2)),
        external_torque=rng.normal(size=(200, 2)) / 3.0,
        segment=np.repeat([0, 1], 100),
        base_orientation=rng.normal(size=(200, 2)),
        posture=np.repeat([0, 3, 1], [80, 20, 100]),
    )
