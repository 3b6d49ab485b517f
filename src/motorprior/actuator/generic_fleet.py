"""Distributions of motors for a robot of which only the description is known.

Scaled from two fleets whose motors were identified from logs, of a robot of 2 kg (1.3 N·m) and one
of 15 kg (24 N·m), see docs/your-robot.md. Relative to the gain kp, their motors are alike: the
rotor on the gain's spring swings at 53 and 45 rad/s, and dry friction leaves an error of 14 and 8
mrad. The fleet is wide, since it stands for motors that nobody has measured: replace it by a prior
of your own logs.
"""

import numpy as np

from motorprior.actuator.distribution import Distribution
from motorprior.robots.robot import Robot

ROTOR_RATE = 50.0  # √(kp/armature) [rad/s]
FRICTION_ERROR = 0.01  # coulomb/kp [rad]
STRIBECK_SHARE = 0.1  # stribeck_torque/coulomb [-]
VISCOUS_TIME = 0.0015  # viscous_damping/kp [s]
GEAR_DAMPING_TIME = 0.007  # gear_damping/kp [s]
MIN_GEAR = 8.0  # gear_stiffness/kp [-]
MAX_GEAR = 40.0
STALL_OVER_LIMIT = 3.0  # stall_torque/torque_limit [-]


def generic_parameters(robot: Robot) -> dict[str, Distribution]:
    """Parameters of geared motors of the size of a robot's gains and torque limits.

    Gains and limits are medians over the joints.

    armature = kp/ROTOR_RATE² and coulomb = FRICTION_ERROR·kp; gear, damping and stall torque scale
    likewise. The uncertainty of the centre, shared by the motors of a robot, is a factor of 1.5 for
    armature and 1.6 for friction. Raises ConfigError for a robot without gains.
    """
    kp, kd = np.median(robot.require_gains(), axis=1).tolist()
    torque_limit = float(np.median([joint.torque_limit for joint in robot.joints]))
    coulomb = FRICTION_ERROR * kp
    return {
        "kp": _lognormal(kp, 0.08, 0.07),
        "kd_over_kp": _lognormal(kd / kp, 0.04, 0.04),
        "delay": _normal(0.004, 0.0015, 0.002, minimum=0.0),
        "velocity_filter": _constant(0.0025),
        "torque_limit": _constant(torque_limit),
        "stall_torque": _constant(STALL_OVER_LIMIT * torque_limit),
        "no_load_speed": _constant(40.0),
        "armature": _lognormal(kp / ROTOR_RATE**2, 0.15, 0.4),
        "coulomb": _lognormal(coulomb, 0.25, 0.5),
        "stribeck_torque": _constant(STRIBECK_SHARE * coulomb),
        "stribeck_velocity": _constant(0.3),
        "viscous_damping": _constant(VISCOUS_TIME * kp),
        "load_friction": _normal(0.12, 0.04, 0.07, minimum=0.0),
        "backlash": Distribution("uniform", {"low": 0.001, "high": 0.02}),
        "gear_stiffness": Distribution("uniform", {"low": MIN_GEAR * kp, "high": MAX_GEAR * kp}),
        "gear_damping": _constant(GEAR_DAMPING_TIME * kp),
        "encoder_zero": _normal(0.0, 0.008, 0.0),
    }


def _constant(value: float) -> Distribution:
    return Distribution("constant", {"center": value})


def _lognormal(center: float, spread: float, center_uncertainty: float) -> Distribution:
    values = {"center": center, "spread": spread, "center_uncertainty": center_uncertainty}
    return Distribution("lognormal", values)


def _normal(
    center: float, spread: float, center_uncertainty: float, **minimum: float
) -> Distribution:
    values = {"center": center, "spread": spread, "center_uncertainty": center_uncertainty}
    return Distribution("normal", {**values, **minimum})
