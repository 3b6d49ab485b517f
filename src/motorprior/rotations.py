"""Compiled rotations; quaternions (w, x, y, z), angles in rad."""

import math

import numpy as np

from motorprior.compiled import njit


@njit(cache=True)
def roll_pitch_yaw(quaternion: np.ndarray) -> tuple[float, float, float]:
    """Intrinsic z-y'-x'' (yaw, pitch, roll) angles [rad] of rotation_base_to_world.

    roll = atan2(2(wx+yz), 1-2(x²+y²)), pitch = asin(2(wy-zx)), yaw = atan2(2(wz+xy), 1-2(y²+z²)).
    """
    w = quaternion[0]
    x = quaternion[1]
    y = quaternion[2]
    z = quaternion[3]
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


@njit(cache=True)
def roll_pitch_below(up: np.ndarray, quaternion: np.ndarray) -> tuple[float, float]:
    """Roll and pitch [rad] of a body relative to gravity; as in `roll_pitch_yaw` if ``up`` is z.

    u = rotation_base_to_worldᵀ·up, roll = atan2(u_y, u_z), pitch = -asin(u_x), with the unit vector
    ``up`` (3,) against gravity, in the world frame.
    """
    w = quaternion[0]
    x = quaternion[1]
    y = quaternion[2]
    z = quaternion[3]
    forward = (
        up[0] * (1.0 - 2.0 * (y * y + z * z))
        + up[1] * 2.0 * (x * y + w * z)
        + up[2] * 2.0 * (x * z - w * y)
    )
    left = (
        up[0] * 2.0 * (x * y - w * z)
        + up[1] * (1.0 - 2.0 * (x * x + z * z))
        + up[2] * 2.0 * (y * z + w * x)
    )
    above = (
        up[0] * 2.0 * (x * z + w * y)
        + up[1] * 2.0 * (y * z - w * x)
        + up[2] * (1.0 - 2.0 * (x * x + y * y))
    )
    return math.atan2(left, above), -math.asin(min(1.0, max(-1.0, forward)))
