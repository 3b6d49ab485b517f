"""The control law of the firmware, for the current of a motor that does not report it."""

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
    """(joints,) current of every motor [A]: kp·(target - joint_pos) - kd·joint_vel, within ±max_current.

    Args:
        target: (joints,) [rad].
        joint_pos: (joints,) [rad], in the signs of ``target``.
        joint_vel: (joints,) [rad/s], the same.
        kp: [A/rad].
        kd: [A·s/rad].
        max_current: [A].
    """
    return np.clip(kp * (target - joint_pos) - kd * joint_vel, -max_current, max_current)
