"""Command modes of a `MotorLog`: its channels, and its gains in force."""

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from motorprior.exceptions import LogError

Log: TypeAlias = Any  # `MotorLog`, which imports this module
# What a command consists of:
# position   a position target
# mit        position target, velocity target and feed-forward torque:
#            torque = kp·(position_target - angle) + kd·(velocity_target - velocity)
#                     + torque_feedforward
# velocity   the same with kp = 0
# torque     the same with kp = kd = 0
COMMAND_MODES = ("position", "mit", "velocity", "torque")
# channels that logs of a command mode have, and channels that they cannot have
_REQUIRED = {"velocity": ("velocity_target",), "torque": ("torque_feedforward",)}
_EXCLUDED = {
    "position": ("velocity_target", "torque_feedforward"),
    "velocity": ("logged_kp",),
    "torque": ("velocity_target", "logged_kp", "logged_kd"),
}


def check_command_mode(log: Log, where: str | Path | None) -> None:
    """Raise LogError for channels or gains that do not fit the command mode of the log."""
    mode = log.command_mode
    remedy = "correct the command mode, or leave the channel out"
    for name in _REQUIRED.get(mode, ()):
        if getattr(log, name) is None:
            raise LogError(f"{mode} commands without {name}", where=where, remedy=remedy)
    for name in _EXCLUDED.get(mode, ()):
        if getattr(log, name) is not None:
            raise LogError(f"{mode} commands with {name}", where=where, remedy=remedy)

    if log.logged_kp is None and log.logged_kd is not None and mode != "velocity":
        raise LogError("kd without kp", where=where, remedy="give both, or kp alone")
    if log.logged_kp is None:
        return
    is_off = ~np.any(log.logged_kp, axis=0)
    if is_off.any():
        joint = log.joint_names[int(is_off.argmax())]
        raise LogError(
            f"logged_kp/{joint} is 0 in every row",
            where=where,
            remedy="leave the joint out, or state another command mode (docs/your-motors.md)",
        )


def gains_change(log: Log) -> bool:
    """Whether logged gains change within a segment, for example in a ramp at the start."""
    for gains in (log.logged_kp, log.logged_kd):
        if gains is None:
            continue
        if any(np.any(gains[rows] != gains[rows.start]) for rows in log.segment_slices()):
            return True
    return False


def reference_gains(log: Log) -> np.ndarray:
    """(2, J) gains to which `gain_factors` refer: `MotorLog.gains`, or 1 without any."""
    gains = log.gains
    return np.ones((2, log.num_joints)) if gains is None else gains


def gain_factors(segment: Log) -> np.ndarray:
    """(2, T, J) gains in force over `reference_gains` of one segment [-].

    They are 1 for gains that are not logged, and 0 for gains that the command mode does not have.
    """
    factors = np.ones((2, *segment.joint_pos.shape))
    for row, gains in enumerate((segment.logged_kp, segment.logged_kd)):
        if gains is not None:
            largest = gains.max(axis=0)
            factors[row] = gains / np.where(largest > 0.0, largest, 1.0)
    if segment.command_mode in ("velocity", "torque"):
        factors[0] = 0.0
    if segment.command_mode == "torque":
        factors[1] = 0.0
    return factors


def unmeasured_scales(trained: str, commanded: str) -> str:
    """What commands of the mode ``commanded`` use, and logs of the mode ``trained`` do not measure.

    For example "position gains"; "" if they measure all.
    """
    used = {
        "position": ("position gains",),
        "mit": ("position gains", "feed-forward torques"),
        "velocity": ("velocity gains",),
        "torque": ("feed-forward torques",),
    }
    measured = used[trained]
    if trained in ("position", "mit"):
        measured += ("velocity gains",)
    return " and ".join(name for name in used[commanded] if name not in measured)
