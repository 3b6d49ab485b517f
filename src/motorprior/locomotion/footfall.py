"""Footfall patterns: which feet are on the ground when."""

from __future__ import annotations

import numpy as np

from motorprior.locomotion.body import body_of
from motorprior.locomotion.trajectory_generator import foot_path
from motorprior.robots.robot import Robot


def planned_stance(robot: Robot, gait: str, cycles: float = 2.0, samples: int = 1000) -> np.ndarray:
    """(cycles · samples, legs) whether each foot is on the ground, as the generator plans it: its lift is 0.

    Args:
        robot: a legged one.
        gait: which leg steps when, see `locomotion.gaits`; its usual ratio of swing to stance.
        cycles: how many, from phase 0.
        samples: per cycle.

    Raises:
        ConfigError: the robot cannot walk in this gait.
    """
    body = body_of(robot, gait)
    stance_share = 1.0 / (1.0 + body.swing_stance_ratio)
    phases = (np.arange(round(cycles * samples))[:, None] / samples + body.phases) % 1.0
    return np.array([[foot_path(phase, stance_share)[1] <= 0.0 for phase in row] for row in phases])
