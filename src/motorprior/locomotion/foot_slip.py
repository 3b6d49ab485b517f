"""How fast feet slide on the ground, from where they are in two control steps."""

from __future__ import annotations

import math

import numpy as np

from motorprior.compiled import njit
from motorprior.locomotion.body import Body

TOUCHING = 0.002
"""A foot whose lowest point is below this height [m] is on the ground."""


@njit(cache=True)
def sliding(
    body: Body,
    feet: np.ndarray,
    foot_pos: np.ndarray,
    joint_pos: np.ndarray,
    pitch: float,
    yaw: float,
    control_dt: float,
) -> float:
    """Sum over the feet of the speed at which they slide on the ground [m/s]; remembers where they are.

    A foot that stayed on the ground has slid by its centre's way less what it rolled, its radius times the turn of the
    shank. It counts nothing where the feet's places are not known.

    Args:
        body: of the robot.
        feet: (legs, 4) as in `control_step.GaitState`, one control step ago; updated in place.
        foot_pos: (legs, 3) centres of the feet [m], world.
        joint_pos: (joints,) [rad].
        pitch: of the body [rad].
        yaw: of the body [rad].
        control_dt: control period [s].
    """
    total, cosine, sine = 0.0, math.cos(yaw), math.sin(yaw)
    for leg in range(body.legs.shape[0]):
        angle = pitch + joint_pos[body.legs[leg, 1]] + joint_pos[body.legs[leg, 2]]
        radius, before = body.foot_radius[leg], feet[leg]
        if foot_pos[leg, 2] < radius + TOUCHING and before[2] < radius + TOUCHING:  # false for NaN
            rolled = radius * (angle - before[3])
            x, y = foot_pos[leg, 0] - before[0] - rolled * cosine, foot_pos[leg, 1] - before[1] - rolled * sine
            total += math.sqrt(x * x + y * y) / control_dt
        before[:3] = foot_pos[leg]
        before[3] = angle
    return total
