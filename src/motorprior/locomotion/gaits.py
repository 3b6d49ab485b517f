"""Gaits: which leg steps when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot

GaitName = Literal["trot", "walk", "pace", "bound", "pronk"]
GAITS: tuple[GaitName, ...] = get_args(GaitName)


@dataclass(frozen=True)
class Pattern:
    """Phases of the four legs of a gait and its usual time in swing over time in stance.

    The leg of phase p touches down when the cycle is at 1 - p.
    """

    front_right: float
    front_left: float
    rear_right: float
    rear_left: float
    swing_stance_ratio: float = 1.0


_PATTERNS: dict[str, Pattern] = {
    "walk": Pattern(0.25, 0.75, 0.5, 0.0, 1.0 / 3.0),  # rear left, front left, rear right, front right: one at a time
    "pace": Pattern(0.0, 0.5, 0.0, 0.5),
    "bound": Pattern(0.0, 0.0, 0.5, 0.5),
    "pronk": Pattern(0.0, 0.0, 0.0, 0.0),
}


def phases_of(robot: Robot, gait: str) -> tuple[np.ndarray, float]:
    """(legs,) phases of a robot's legs in a gait, in [0, 1), and its usual time in swing over time in stance.

    A trot has the phases that the robot's own description gives.

    Raises:
        ConfigError: an unknown gait, or one for four legs on a robot that has others.
    """
    if gait not in GAITS:
        raise ConfigError(f"gait {gait!r} is unknown", remedy=f"use one of {', '.join(GAITS)}", argument="gait")
    if gait == "trot":
        return np.array([leg.phase for leg in robot.legs]), 1.0
    pattern, corners = _PATTERNS[gait], _corners(robot)
    if len(set(corners)) != len(robot.legs) or len(robot.legs) != 4:
        raise ConfigError(
            f"gait {gait!r} is for four legs, one at each corner of the body",
            remedy="use the gait trot, which has the phases of the robot's own file", argument="gait",
        )  # fmt: skip
    return np.array([getattr(pattern, corner) for corner in corners]), pattern.swing_stance_ratio


def _corners(robot: Robot) -> list[str]:
    middle = float(np.mean([leg.rest[0] for leg in robot.legs]))
    return [
        f"{'front' if leg.rest[0] > middle else 'rear'}_{'left' if leg.rest[1] > 0.0 else 'right'}"
        for leg in robot.legs
    ]
