"""How policies follow commands to turn, to go backward and to stand; part of walking.py."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from motorprior.results import Result
from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import Episode
from motorprior.transfer.gait_quality import WARM_UP, headings, lasted, way_along

TURNS = "commanded/"
"""Beginning of the names of these quantities."""
COMMANDS = (
    (0.6, 1.0), (0.6, -1.0), (0.0, 1.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.0), (0.1, 0.0),
    (1.0, 0.0), (1.0, 1.0), (1.0, -1.0),
)  # fmt: skip
"""Commanded speed as a share of the robot's fastest, forward or, below 0, backward; and yaw rate as a share of its
fastest turn, to the left."""
UNITS = {"upright": "1", "speed": "m/s", "yaw_rate": "rad/s"}


def commands_of(robot: Robot) -> list[tuple[float, float]]:
    """COMMANDS in m/s and rad/s."""
    legs = robot.require_legs()
    slowest, fastest = legs.forward
    return [(share * (fastest if share > 0.0 else -slowest), turn * legs.yaw_rate) for share, turn in COMMANDS]


def followed(robot: Robot, episodes: Sequence[Episode], steps: int) -> dict[str, float]:
    """Over walks of one command: share without a fall; of these walks speed [m/s] and yaw rate [rad/s]."""
    whole = [each for each in episodes if lasted(each, steps)]
    found = {"upright": len(whole) / len(episodes)}
    if whole:
        rates = [_rates(robot, each) for each in whole]
        found |= dict(zip(("speed", "yaw_rate"), map(float, np.mean(rates, axis=0)), strict=True))
    return found


def _rates(robot: Robot, episode: Episode) -> tuple[float, float]:
    """Speed along the heading [m/s] and yaw rate [rad/s] after the first second."""
    qpos = episode.trace[round(WARM_UP / robot.control_dt) :]
    yaw = headings(qpos)
    time = robot.control_dt * (len(qpos) - 1)
    return way_along(qpos[:, :2], yaw) / time, float(yaw[-1] - yaw[0]) / time


def rows_of(place: str, command: tuple[float, float], seed: int, found: dict[str, float]) -> Iterator[Result]:
    """The measures of one policy."""
    told = "told {:.3g} m/s {:.3g} rad/s".format(*command)
    for name, value in found.items():
        yield Result(TURNS + name, UNITS[name], value, motors=place, part=told, seed=seed)
