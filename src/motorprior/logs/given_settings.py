"""Gains, registers and conditions that the user gives at import; they override those of the log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked
from motorprior.robots.robot import Robot


def with_settings(
    log: MotorLog,
    gains: Mapping[str, Sequence[float]],
    firmware: Mapping[str, float],
    conditions: Mapping[str, float],
    robot: Robot,
) -> tuple[MotorLog, list[str]]:
    """The log with these gains, registers and conditions, and messages about the gains for the user.

    Args:
        log: of one robot.
        gains: "kp" and "kd": none, one for all joints, or one per joint in the robot's order.
        firmware: registers.
        conditions: some of `motor_log.CONDITIONS`, for all joints and rows.
        robot: gives the order of several gains.

    Raises:
        ConfigError: a wrong number of gains, or several for joints that are not in the robot's order.
        LogError: a register out of its bounds.
    """
    values: dict[str, Any] = {}
    messages = []
    for name, given in gains.items():
        if len(given) not in (0, 1, log.num_joints):
            problem = f"{name}: {len(given)} gains for {log.num_joints} joints"
            raise ConfigError(problem, remedy="give one, or one per joint", argument=name)
        if len(given) > 1:
            if log.joint_names != tuple(joint for joint in robot.joint_names if joint in log.joint_names):
                problem = f"{name}: several gains; the joints {', '.join(log.joint_names)} are not in a robot's order"
                remedy = f"give them in the column map ([joints.{log.joint_names[0]}] {name} = …), or give the robot"
                raise ConfigError(problem, where=log.source, argument=name, remedy=remedy)
            pairs = zip(log.joint_names, given, strict=True)
            messages.append(f"{name}: {', '.join(f'{joint} {value:g}' for joint, value in pairs)}")
        if given:
            values[f"stated_{name}"] = np.broadcast_to(np.array(given), log.joint_pos.shape)
    if gains["kp"] and not gains["kd"] and log.stated_kd is not None:
        messages.append("kp is replaced; kd is still that of the log or its column map (give kd to change it)")
    values |= {name: np.full(log.joint_pos.shape, value) for name, value in conditions.items()}
    if firmware:
        values["firmware"] = {**log.firmware, **firmware}
    return (checked(replace(log, **values), where=log.source) if values else log), messages
