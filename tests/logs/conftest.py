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
        angle = 0.3 * np.sin(2 * np.pi * 1.0 * time[:, None] + np.array([0.0, 1.0]))
        late = 0.3 * np.sin(2 * np.pi * 1.0 * (time[:, None] - 0.05) + np.array([0.0, 1.0]))
        speed = (
            0.3
            * 2
            * np.pi
            * np.cos(2 * np.pi * 1.0 * (time[:, None] - 0.05) + np.array([0.0, 1.0]))
        )
        return log_of(
            time, angle, late, **({"joint_vel": speed, "joint_names": ("left", "right")} | changes)
        )

    return make


@pytest.fixture
def rich_log() -> MotorLog:
    """A good bench log: 12 s of 2 joints that follow sums of sines 50 ms late, on known loads."""
    time = 0.01 * np.arange(1200)
    ways = ((0.3, 0.4), (0.15, 1.1), (0.06, 2.7))  # rad, Hz

    def motion(late: float, order: int) -> np.ndarray:
        """Derivative of that order."""
        angular = [
            2 * np.pi * rate * (time[:, None] - late) + [0.0, 1.0] + np.pi / 2 * order
            for _, rate in ways
        ]
        return sum(
            (
                size * (2 * np.pi * rate) ** order * np.sin(phase)
                for (size, rate), phase in zip(ways, angular, strict=True)
            ),
            start=np.zeros((len(time), 2)),
        )

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
    time = np.concatenate(
        [np.cumsum(rng.uniform(1e-3, 2e-3, 100)), np.cumsum(rng.uniform(1e-3, 2e-3, 100))]
    )
    return make_log(
        time=time,
        joint_torque=rng.normal(size=(200, 2)) * 1e-300,
        load_inertia=rng.uniform(1e-4, 1e-2, (200, 2)),
        external_torque=rng.normal(size=(200, 2)) / 3.0,
        segment=np.repeat([0, 1], 100),
        base_orientation=rng.normal(size=(200, 2)),
        posture=np.repeat([0, 3, 1], [80, 20, 100]),
    )
