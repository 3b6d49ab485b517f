"""Bounds of the numbers in a prior's file: wide of all that a training finds, short of what no simulation survives."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from motorprior.actuator.geared_motor_constants import parameters_of
from motorprior.actuator.limits_not_shown import NOT_SHOWN, UNKNOWN_SIZE
from motorprior.actuator.servo_terms import SIGNED, TERMS
from motorprior.exceptions import ArtifactError, LogError, spelled
from motorprior.schema import number, require

# A training drives what a motor does not have, such as friction, towards 0; so small it may be
NOTHING = math.exp(-30.0)
# (least, most) of a grey box's constants at z = 0, in SI units
CENTRAL_MOTOR = {
    "kp": (1e-3, 1e3), "kd_over_kp": (NOTHING, 10.0), "velocity_filter": (NOTHING, 10.0), "delay": (NOTHING, 1.0),
    "torque_limit": (1e-3, 1e3), "armature": (1e-6, 1.0), "coulomb": (NOTHING, 1e3), "stribeck_torque": (NOTHING, 1e3),
    "viscous_damping": (NOTHING, 1e3), "load_friction": (NOTHING, 10.0), "gear_stiffness": (1e-3, 1e7),
    "backlash": (NOTHING, 1.0), "gear_damping": (NOTHING, 1e2), "encoder_zero": (-1.5, 1.5),
    "profile_speed": (1e-3, 1e6), "profile_acceleration": (1e-3, 1e9), "dead_zone": (NOTHING, 1.0),
    "integral_rate": (NOTHING, 1e3), "integral_limit": (NOTHING, 1e3), "stall_torque": (1e-3, 1e6),
    "no_load_speed": (1e-3, 1e6), "current_time": (NOTHING, 1.0), "asymmetry": (-1.0, 1.0),
    "bristle_stiffness": (1e-3, 1e7), "output_damping": (NOTHING, 1e2), "heat_loss": (NOTHING, 1.0),
    "heat_time": (1e-3, 1e6), "supply_share": (NOTHING, 1e2), "temperature_loss": (-10.0, 10.0),
}  # fmt: skip
_GAIN_UNITS = {"kp": "N·m/rad", "kd_over_kp": "s"}
LARGEST_SLOPE = 10.0  # Of the logarithm of a motor's constant over a latent of N(0, 1)
LARGEST_LOSS, LARGEST_METRIC = 1e6, 1e12  # A loss is of order 1; the square of any metric can be computed with
_REMEDY, _LONGEST_NAME = "identify it again", 80
_REMEDY_OF_LOGS = (
    "identify it again from logs in which no joint runs against its command, has its zero elsewhere than its command, "
    "or is in another unit (`motorprior logs check`)"
)
# Names of the figures that an identification finds
_METRIC = re.compile(
    "final_loss|minutes_of_log|aggregate_posterior_kl|replay_rmse|unexplained"
    f"|saved_({'|'.join(TERMS)}|residual)"
    f"|{NOT_SHOWN}({'|'.join(parameters_of(tuple(TERMS)))})|{UNKNOWN_SIZE}"
    "|loss_(mean|log_mean|log_std|motors|pieces|piece_variance)(_without_torque)?"
    "|residual_p[0-9]{2}_(slow|medium|fast)"
)


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
    units = {} if gains is None else typical_gains(gains)
    for name, raw in zip(names, center.tolist(), strict=True):
        value = SIGNED[name] * raw if name in SIGNED else math.exp(raw)
        value *= units.get(name) or 1.0  # a motor that is told no damping may have any multiple of it
        require(name, value, number(*CENTRAL_MOTOR[name]), path, _REMEDY_OF_LOGS, "motor_center")


def typical_gains(gains: np.ndarray) -> dict[str, float]:
    """Medians of kp [N·m/rad] and kd_over_kp [s] of motors with gains (2, M); 0 s where none is told any damping."""
    return {"kp": float(np.median(gains[0])), "kd_over_kp": float(np.median(gains[1] / gains[0]))}


def check_stated_gains(gains: np.ndarray, where: str | Path) -> None:
    """Refuse a log of motors (2, M) whose stated gains [N·m/rad], [N·m·s/rad] a central motor cannot have.

    Raises:
        LogError: names the gain, its median and its bounds.
    """
    for name, value in typical_gains(gains).items():
        least, most = CENTRAL_MOTOR[name]
        if value and not least <= value <= most:
            raise LogError(
                f"stated gains: the motors' median {name} = {value:.4g} is not from {least:.3g} to {most:g} "
                f"{_GAIN_UNITS[name]}",
                where=where,
                remedy="state them in N·m/rad and N·m·s/rad or, of units of the firmware's own, say so "
                '(gain = "firmware" in the column map)',
            )


def check_metrics(metrics: dict[str, object], path: Path) -> None:
    """Refuse metrics that no identification writes, or that are not finite numbers of a sensible size.

    Raises:
        ArtifactError: names the metric, and its value and its bound.
    """
    for name, value in metrics.items():
        if not _METRIC.fullmatch(name):
            said = spelled(name, _LONGEST_NAME)
            raise ArtifactError(f"metrics: {said} is no figure of an identification", where=path, remedy=_REMEDY)
        most = LARGEST_LOSS if name.startswith("loss_") else LARGEST_METRIC
        require(name[:_LONGEST_NAME], value, number(-most, most), path, _REMEDY, "metrics")
