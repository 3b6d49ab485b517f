"""What a motor's controller is told: the firmware's law, for whoever has to know a current that is not sent."""

from __future__ import annotations

import numpy as np


def servo_current(
    target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    kp: np.ndarray | float,
    kd: np.ndarray | float,
    max_current: float,
) -> np.ndarray:
    """(12,) current of every motor [A]: kp·(target - joint_pos) - kd·joint_vel, within ±max_current.

    Args:
        target: (12,) [rad].
        joint_pos: (12,) [rad], in the signs of ``target``.
        joint_vel: (12,) [rad/s], the same.
        kp: [A/rad].
        kd: [A·s/rad].
        max_current: [A].
    """
    return np.clip(kp * (target - joint_pos) - kd * joint_vel, -max_current, max_current)
