"""Gains and registers that a user states for the motors of a log, in place of what the log says itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.bounds import require_number
from motorprior.exceptions import ConfigError
from motorprior.logs.formats.column_map import KD, KP
from motorprior.logs.motor_log import CONDITIONS, MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot

_BOUNDS = {"kp": KP, "kd": KD, **CONDITIONS}


def require_within_bounds(stated: Mapping[str, Sequence[float]]) -> None:
    """Refuse gains that no motor has, and conditions that none bears.

    Args:
        stated: "kp" and "kd", of one or more joints, and conditions (`motor_log.CONDITIONS`).

    Raises:
        ConfigError: names the argument, the value and the bounds.
    """
    for name, values in stated.items():
        for value in values:
            require_number(name, value, *_BOUNDS[name])


def with_stated(
    log: MotorLog,
    gains: Mapping[str, Sequence[float]],
    firmware: Mapping[str, float],
    conditions: Mapping[str, float],
    robot: Robot,
) -> tuple[MotorLog, tuple[str, ...]]:
    """The log with these gains, registers and conditions.

    Args:
        log: of one robot.
        gains: "kp" and "kd": none, one for all joints, or one per joint in the robot's order.
        firmware: registers of the firmware.
        conditions: some of `motor_log.CONDITIONS`, of all joints and rows.
        robot: whose order it is.

    Returns:
        The log, and the sentences for the user: of every list of gains which joint gets which, and which gains stay.

    Raises:
        ConfigError: another number of gains than joints, or several where the joints are not in the robot's order.
        LogError: a register out of its bounds.
    """
    stated: dict[str, Any] = {}
    told = []
    for name, values in gains.items():
        if len(values) not in (0, 1, log.num_joints):
            problem = f"{name}: {len(values)} gains for {log.num_joints} joints"
            raise ConfigError(problem, remedy="give one, or one per joint", argument=name)
        if len(values) > 1:
            _require_order(name, log, robot)
            pairs = zip(log.joint_names, values, strict=True)
            told.append(f"{name}: {', '.join(f'{joint} {value:g}' for joint, value in pairs)}")
        if values:
            stated[f"stated_{name}"] = np.broadcast_to(np.array(values), log.joint_pos.shape)
    if gains.get("kp") and not gains.get("kd") and log.stated_kd is not None:
        told.append("kp is replaced, kd stays as the log or its column map states it (give kd as well to change it)")
    stated |= {name: np.full(log.joint_pos.shape, value) for name, value in conditions.items()}
    if firmware:
        stated["firmware"] = {**log.firmware, **firmware}
    return (checked(replace(log, **stated), where=log.source) if stated else log), tuple(told)


def _require_order(name: str, log: MotorLog, robot: Robot) -> None:
    if log.joint_names != tuple(joint for joint in robot.joint_names if joint in log.joint_names):
        raise ConfigError(
            f"{name}: several gains, and the joints {', '.join(log.joint_names)} are not in the order of a given robot",
            where=log.source, argument=name,
            remedy=f"state them in the column map ([joints.{log.joint_names[0]}] {name} = …), or give their robot",
        )  # fmt: skip
