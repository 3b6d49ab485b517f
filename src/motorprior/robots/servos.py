"""Servos of a robot on a serial bus, and the interface between their firmware and their motors."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True)
class ServoChain:
    """The servos of a robot on one serial bus, in the order of its joints."""

    model: str  # name of the servo, a key of `hardware.buses.registry.SERVOS`
    ids: tuple[int, ...]  # id on the bus of each joint's servo
    signs: tuple[int, ...]  # direction in which counts grow: 1 with the joint's angle, or -1
    zeros: tuple[int, ...]  # encoder count at joint angle 0
    # for a virtual robot: name of the fleet of its motors, and angles near which it rests without
    # torque [rad] (none: the nominal pose)
    fleet: str = ""
    rest: tuple[float, ...] = ()


class ServoCommand(NamedTuple):
    """What the firmware of n servos sets, (n,) each, at the joints."""

    target: np.ndarray  # goal position [rad]
    enabled: np.ndarray  # bool: torque is on
    gain: np.ndarray  # proportional gain over that of the motors' constants [-]
    torque_share: np.ndarray  # torque limit over the full one [-]
    speed: np.ndarray  # limit of the profile [rad/s]; 0: none
    acceleration: np.ndarray  # limit of the profile [rad/s²]; 0: none
    supply: np.ndarray  # supply voltage over that of the motors' constants [-]
    blocked: np.ndarray  # bool: an obstacle holds the joint


class ServoState(NamedTuple):
    """What the sensors of n servos see, (n,) each, at the joints."""

    pos: np.ndarray  # [rad]
    vel: np.ndarray  # [rad/s]
    duty: np.ndarray  # torque of the control law over its limit, in [-1, 1]


class MotionPart(NamedTuple):
    """A part of a recording: targets that servos play, one row per control period."""

    name: str  # for the user
    targets: np.ndarray  # (steps, n) [rad]
