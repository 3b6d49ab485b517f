"""Rotations, quaternions as (w, x, y, z), angles in rad. Compiled, so the rollout kernel can inline them."""

from __future__ import annotations

import math

import numpy as np

from motorprior.compiled import njit


@njit(cache=True)
def roll_pitch_yaw(quaternion: np.ndarray) -> tuple[float, float, float]:
    """Intrinsic z-y'-x'' (yaw, pitch, roll) angles [rad] of rotation_base_to_world.

    roll = atan2(2(wx+yz), 1-2(x²+y²)), pitch = asin(2(wy-zx)), yaw = atan2(2(wz+xy), 1-2(y²+z²)).
    """
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw
