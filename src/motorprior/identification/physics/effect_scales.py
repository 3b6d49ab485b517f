"""Values of constants that begin to have an effect on a log.

A search draws constants in proportion to these values, so that it finds motors of any size. The
uncertainty of a constant is linear far below them, and logarithmic far above (`estimates`).
"""

from collections.abc import Mapping

import numpy as np

from motorprior.identification import windows as channel
from motorprior.identification.physics.window_runs import SPEED_LIMITS, WindowRuns

# the same for all motors
_CONSTANT_SCALES = {
    "delay": 1e-3,  # [s]
    "velocity_filter": 1e-3,  # [s]
    "kd_over_kp": 2e-3,  # [s]
    "backlash": 1e-3,  # [rad]
    "load_friction": 0.02,
}


def effect_scale(name: str, values: Mapping[str, np.ndarray], runs: WindowRuns) -> np.ndarray:
    """(M, ...) scale of a constant of the motors with these ``values`` (M, ...), 0 if it has none.

    The scale of a torque limit is the largest request, the scale of a limit of speed the speed that
    the joint sustained. The scale of a gear stiffness is a compliance, in rad/(N·m). Others are in
    the unit of the constant.
    """
    shape = values["kp"].shape
    per_motor = (len(values["kp"]), *[1] * (len(shape) - 1))

    def of_motor(value: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.reshape(value, per_motor), shape)

    if name in _CONSTANT_SCALES:
        return np.full(shape, _CONSTANT_SCALES[name])
    if name in SPEED_LIMITS:
        return of_motor(runs.sustained_speeds[name])
    if name == "armature":
        inertia = [segment.rows[:, channel.INERTIA].mean(axis=0) for segment in runs.segments]
        return of_motor(0.1 * np.mean(inertia, axis=0))

    if name in ("torque_limit", "coulomb", "stribeck_torque"):
        request = values["kp"] * of_motor(runs.max_request)  # [N·m]
        return request if name == "torque_limit" else 0.02 * request
    if name in ("viscous_damping", "gear_stiffness"):
        gains = runs.gains if runs.recipe.gain_unit else np.ones_like(runs.gains)
        kp = values["kp"] * of_motor(gains[0])  # [N·m/rad]
        kd = kp * values["kd_over_kp"] * of_motor(gains[1] / gains[0])  # [N·m·s/rad]
        return 0.3 * kd if name == "viscous_damping" else 0.02 / kp
    return np.zeros(shape)
