"""Command modes of a `MotorLog`: its channels, and its gains in force."""

from collections.abc import Sequence
from dataclasses import replace
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
# gains without which logs of several modes cannot share the mode: in some of them, they are 0
_SHARED_GAINS = {"mit": ("logged_kp", "logged_kd"), "velocity": ("logged_kd",)}


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


def commands_angles(log: Log) -> np.ndarray:
    """(J,) whether position targets act on a joint: not in velocity and torque mode, nor at kp 0.

    A joint of a robot in MIT mode has kp = 0 in every row if it is passive, or under velocity or
    torque control.
    """
    if log.command_mode in ("velocity", "torque"):
        return np.zeros(log.num_joints, dtype=bool)
    if log.logged_kp is None:
        return np.ones(log.num_joints, dtype=bool)
    return np.any(log.logged_kp, axis=0)


def in_common_mode(logs: Sequence[Log]) -> list[Log]:
    """The logs in one command mode, with 0 for commands and gains that some modes do not have.

    It is MIT mode if a log has position targets, else velocity mode. Logs of one mode differ by
    velocity targets and feed-forward torques only: those that were always 0 are not read.

    Raises `LogError` for logs of several modes, some without position or velocity control, that
    all lack a gain.
    """
    modes = {log.command_mode for log in logs}
    mode = "mit" if modes & {"position", "mit"} else "velocity"
    if len(modes) == 1:
        (mode,) = modes
    elif modes & {"velocity", "torque"}:
        _require_shared_gains(logs, mode)
    # gains that the mode has, if any log has them
    names = [name for name in ("logged_kp", "logged_kd") if name not in _EXCLUDED.get(mode, ())]
    names += ["velocity_target", "torque_feedforward"]
    present = [name for name in names if any(getattr(log, name) is not None for log in logs)]
    return [_in_mode(log, mode, present) for log in logs]


def _require_shared_gains(logs: Sequence[Log], mode: str) -> None:
    """Raise LogError if no log has a gain that is 0 in some of them.

    Gains that are not logged count as in force (`gain_factors`), so that a simulated motor under
    torque commands would be servoed to its own recorded angle.
    """
    missing = [
        name.removeprefix("logged_")
        for name in _SHARED_GAINS[mode]
        if all(getattr(log, name) is None for log in logs)
    ]
    if missing:
        modes = sorted({log.command_mode for log in logs}, key=COMMAND_MODES.index)
        gains = " and ".join(missing)
        raise LogError(
            f"{' and '.join(modes)} commands, and no log has {gains}",
            where="; ".join(dict.fromkeys(log.source for log in logs)),
            remedy=f"give {gains} of every log that uses them, or fit one mode at a time",
        )


def _in_mode(log: Log, mode: str, names: Sequence[str]) -> Log:
    """The log in another command mode, with 0 for commands and gains ``names`` that it lacks."""
    zero_gains = {"velocity": ("logged_kp",), "torque": ("logged_kp", "logged_kd")}
    always_zero = (*zero_gains.get(log.command_mode, ()), "velocity_target", "torque_feedforward")
    values = {
        name: np.zeros_like(log.joint_pos)
        for name in names
        if getattr(log, name) is None and name in always_zero
    }
    return replace(log, command_mode=mode, **values)


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
        "mit": ("position gains", "velocity gains", "feed-forward torques"),
        "velocity": ("velocity gains",),
        "torque": ("feed-forward torques",),
    }
    measured = used[trained]
    if trained == "position":  # it damps by the velocity gain
        measured += ("velocity gains",)
    return " and ".join(name for name in used[commanded] if name not in measured)
