"""Bounds of the numbers in a prior's file: wide of all that a training finds, short of what no simulation survives."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from motorprior.actuator.servo_terms import SIGNED
from motorprior.schema import number, require

NOTHING = math.exp(-30.0)
"""A training drives what a motor does not have, such as friction, towards 0; so small it may be."""
CENTRAL_MOTOR = {
    "kp": (1e-3, 1e3), "kd_over_kp": (NOTHING, 10.0), "velocity_filter": (NOTHING, 10.0), "delay": (NOTHING, 1.0),
    "torque_limit": (1e-3, 1e3), "armature": (1e-6, 1.0), "coulomb": (NOTHING, 1e3), "stribeck_torque": (NOTHING, 1e3),
    "viscous_damping": (NOTHING, 1e3), "load_friction": (NOTHING, 10.0), "gear_stiffness": (1e-3, 1e7),
    "backlash": (NOTHING, 1.0), "gear_damping": (NOTHING, 1e2), "encoder_zero": (-1.5, 1.5),
    "profile_speed": (1e-3, 1e6), "profile_acceleration": (1e-3, 1e9), "dead_zone": (NOTHING, 1.0),
    "integral_rate": (NOTHING, 1e3), "integral_limit": (NOTHING, 1e3), "stall_torque": (1e-3, 1e6),
    "no_load_speed": (1e-3, 1e6), "current_time": (NOTHING, 1.0), "asymmetry": (-1.0, 1.0),
    "bristle_stiffness": (1e-3, 1e7), "output_damping": (NOTHING, 1e2), "heat_loss": (NOTHING, 1.0),
    "heat_time": (1e-3, 1e6),
}  # fmt: skip
"""(least, most) of a grey box's constants at z = 0, in SI units."""
LARGEST_SLOPE = 10.0
"""Of the logarithm of a motor's constant over a latent of N(0, 1)."""
LARGEST_LOSS, LARGEST_METRIC = 1e6, 1e12
"""A loss is of order 1; the square of any metric can be computed with."""
_REMEDY, _LONGEST_NAME = "identify it again", 80


def check_central_motor(
    center: np.ndarray, names: tuple[str, ...], path: Path, gains: np.ndarray | None = None
) -> None:
    """Refuse a grey box whose central motor is none.

    Args:
        center: (P,) of `GearedMotor`.
        names: of its constants.
        path: for the message.
        gains: (2, M) stated kp and kd of the training motors, of which kp and kd are multiples; none if not given.

    Raises:
        ArtifactError: names the constant, its value in SI units and its bounds.
    """
    told = {} if gains is None else {"kp": gains[0], "kd_over_kp": gains[1] / gains[0]}
    units = {name: float(np.median(values)) for name, values in told.items()}
    for name, raw in zip(names, center.tolist(), strict=True):
        value = SIGNED[name] * raw if name in SIGNED else math.exp(raw)
        value *= units.get(name) or 1.0  # a motor that is told no damping may have any multiple of it
        require(name, value, number(*CENTRAL_MOTOR[name]), path, _REMEDY, "motor_center")


def check_metrics(metrics: dict[str, object], path: Path) -> None:
    """Refuse metrics that are not finite numbers of a sensible size.

    Raises:
        ArtifactError: names the metric, its value and its bound.
    """
    for name, value in metrics.items():
        most = LARGEST_LOSS if name.startswith("loss_") else LARGEST_METRIC
        require(name[:_LONGEST_NAME], value, number(-most, most), path, _REMEDY, "metrics")
