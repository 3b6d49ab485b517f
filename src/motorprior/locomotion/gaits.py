"""Gaits: phases of the legs."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot

GaitName = Literal["trot", "walk", "pace", "bound", "pronk"]
GAITS: tuple[GaitName, ...] = get_args(GaitName)


_CORNERS = ("front right", "front left", "rear right", "rear left")
# Phases of the legs at _CORNERS; the leg of phase p touches down when the cycle is at 1 - p.
_PHASES = {
    "walk": (0.25, 0.75, 0.5, 0.0),  # rear left, front left, rear right, front right: one at a time
    "pace": (0.0, 0.5, 0.0, 0.5),
    "bound": (0.0, 0.0, 0.5, 0.5),
    "pronk": (0.0, 0.0, 0.0, 0.0),
}


def phases_of(robot: Robot, gait: str) -> tuple[np.ndarray, float]:
    """(legs,) phases of a robot's legs in a gait, in [0, 1), and its usual time in swing over time in stance.

    The phases of a trot are in the robot's description.

    Raises:
        ConfigError: an unknown gait, or one for four legs on a robot that has others.
    """
    if gait not in GAITS:
        raise ConfigError(f"gait {gait!r} is unknown", remedy=f"use one of {', '.join(GAITS)}", argument="gait")
    if gait == "trot":
        return np.array([leg.phase for leg in robot.legs]), 1.0
    middle = float(np.mean([leg.rest[0] for leg in robot.legs]))
    corners = [
        f"{'front' if leg.rest[0] > middle else 'rear'} {'left' if leg.rest[1] > 0.0 else 'right'}"
        for leg in robot.legs
    ]
    if sorted(corners) != sorted(_CORNERS):
        raise ConfigError(
            f"gait {gait!r} is for four legs, one at each corner of the body",
            remedy="use the gait trot, whose phases are in the robot's file", argument="gait",
        )  # fmt: skip
    phases = np.array([_PHASES[gait][_CORNERS.index(corner)] for corner in corners])
    return phases, 1.0 / 3.0 if gait == "walk" else 1.0
