"""The initial motor of a fit: a small geared servo, scaled to the motors of the logs.

A decoder reaches constants within a factor of 12 of its central motor, but kp of servos and quadrupeds spans 1 to
40 N·m/rad. Gains that are logged in N·m/rad set the scale. Elsewhere several scales of all torques, and of the gain
alone, are tried on the logs, and the fit starts from the best if its loss is less than half the initial motor's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import CONSTANTS, INITIAL, SIGNED
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import Preset
from motorprior.logs.motor_log import PHYSICAL_GAINS

INITIAL_MOTOR = {
    "kp": 10.0, "kd_over_kp": 0.09, "velocity_filter": 0.003, "delay": 0.008, "torque_limit": 1.5, "armature": 0.002,
    "coulomb": 0.06, "stribeck_torque": 0.01, "viscous_damping": 0.004, "load_friction": 0.2, "gear_stiffness": 70.0,
    "backlash": 0.015, "gear_damping": 0.03, **INITIAL,
}  # fmt: skip
# Constants that scale with the size of a motor
TORQUES = (
    "kp", "torque_limit", "armature", "coulomb", "stribeck_torque", "viscous_damping", "gear_stiffness", "gear_damping",
    *(name for name, constant in CONSTANTS.items() if constant.unit.startswith("N·m")),
)  # fmt: skip


def initial_center(terms: tuple[str, ...], runs: WindowRuns | None = None) -> np.ndarray:
    """(P,) decoder outputs of the initial motor; its limits of speed, logged gains and firmware are those of the logs.

    Where gains are logged in N·m/rad, every torque of the initial motor is that of a motor with such gains.
    """
    if runs is None:
        return encoded(INITIAL_MOTOR, terms)
    motor = INITIAL_MOTOR | dict.fromkeys(runs.preset.lacks, 1e-9)
    if runs.max_speed:
        # a little above the logged speeds: a limit that is too low rises in the fit, one that is too high has no effect
        profile = 1.1 * float(np.median(runs.sustained_speeds["profile_speed"])) or runs.max_speed
        motor = motor | {"profile_speed": profile, "no_load_speed": 1.3 * runs.max_speed}
    motor = motor | runs.preset.logged_values
    if not runs.gain_unit:
        return encoded(motor, terms)
    kp, ratio = float(np.median(runs.gains[0])), float(np.median(runs.gains[1] / runs.gains[0])) or 1.0
    if runs.gain_unit == PHYSICAL_GAINS:
        factor = kp / INITIAL_MOTOR["kp"]
        motor = motor | {name: factor * motor[name] for name in TORQUES if name in motor}
        needed = float(np.median(runs.max_request))
        limit = float(np.sqrt(motor["torque_limit"] * max(motor["torque_limit"], 2.0 * needed)))  # it may saturate
        motor = motor | {"kp": 1.0, "torque_limit": limit} | ({"kd_over_kp": 1.0} if logs_kd(runs) else {})
    else:
        motor = motor | {"kp": motor["kp"] / kp, "kd_over_kp": motor["kd_over_kp"] / ratio}
    return encoded(motor, terms)


def logs_kd(runs: WindowRuns) -> bool:
    """Whether the logs have kd: where they do not, it is set to kp (`windows`)."""
    return bool(np.any(runs.gains[1] != runs.gains[0]))


def encoded(values: Mapping[str, float], terms: tuple[str, ...]) -> np.ndarray:
    """(P,) decoder outputs of a motor with these constants; outputs of constants that are not given are 0."""
    return np.array([
        values.get(name, 0.0) / SIGNED[name] if name in SIGNED else np.log(values.get(name, 1.0))
        for name in parameters_of(terms)
    ])  # fmt: skip


def grey_box(center: np.ndarray, terms: tuple[str, ...], preset: Preset) -> GreyBox:
    """The decoder around a central motor (P,), with one latent per constant."""
    return GreyBox(GearedMotor(center, np.eye(len(center)), terms), preset.period, gain_unit=preset.gain_unit)
