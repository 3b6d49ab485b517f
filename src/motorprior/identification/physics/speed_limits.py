"""Least limits of speed from which motors are sought: the speeds that they held.

A limit that begins above every speed of a log shows nowhere, and one far below the motor's own keeps a search in a poor
optimum. Held is what a joint never falls below for HELD_SECONDS on its way towards its target: an impact drives a joint
faster than its motor goes, but seldom for so long. Seldom is not never: on three benches of 32 motors of foreign_servo
12, 19 and 25 % of the motors held more than their firmware's limit, by up to 24 %. So random searches and restarts keep
the bound, and Gauss-Newton steps from there do not; where steps kept it, too, the motors were 0.7 mrad further off
under impacts (means of three searches). With speeds held for 0.2 s no motor is bounded above its limit, but so weak a
bound guides no search. A voltage's limit of speed grows with the voltage: it is the one at the usual voltage.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import minimum_filter1d

from motorprior.actuator.geared_motor_constants import LOG_REACH, parameters_of

SPEED_LIMITS = ("profile_speed", "no_load_speed")
HELD_SECONDS = 0.1  # So long a motor's own speed lasts at least
MARGIN = 1.02  # Least limit of speed over the speed that the motor held [-]


def held_speed(vel: np.ndarray, error: np.ndarray, period: float) -> np.ndarray:
    """(M,) largest speed [rad/s] that each joint held for HELD_SECONDS on its way to its target; 0 where none did.

    Args:
        vel: (M, R) joint velocities. The end of a segment and the beginning of the next count as one motion: a speed
            that is held through both is held in both.
        error: (M, R) position_target - joint_pos.
        period: of the rows [s].
    """
    rows, lowest = max(1, round(HELD_SECONDS / period)), []
    for way in (1.0, -1.0):
        towards = np.where(way * error > 0.0, np.maximum(way * vel, 0.0), 0.0)
        lowest.append(minimum_filter1d(towards, rows, axis=1, mode="constant", cval=0.0))
    return np.max(lowest, axis=(0, 2)).astype(np.float64)


def least_outputs(center: np.ndarray, terms: tuple[str, ...], held: Mapping[str, np.ndarray]) -> np.ndarray:
    """(M, P) least decoder outputs, relative to the central motor's, of searches for motors that held these speeds.

    -inf where nothing bounds them; never above what the decoder reaches.

    Args:
        center: (P,) decoder outputs of the central motor.
        terms: of the motors.
        held: (M,) speeds [rad/s] that tell of each of SPEED_LIMITS.
    """
    least = np.full((len(held[SPEED_LIMITS[0]]), len(center)), -np.inf)
    for row, name in enumerate(parameters_of(terms)):
        if name in SPEED_LIMITS:
            with np.errstate(divide="ignore"):
                least[:, row] = np.minimum(np.log(MARGIN * held[name]) - center[row], LOG_REACH)
    return least
