"""How policies follow commands to turn, to go backward, to stand, and to stop and go; part of walking.py."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from motorprior.locomotion.command import Commands, Timetable
from motorprior.results import Result
from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import Episode
from motorprior.transfer.gait_quality import WARM_UP, completed, distance_along_heading, headings

TURNS = "commanded/"
"""Beginning of the names of these quantities."""
COMMANDS = (
    (0.6, 1.0), (0.6, -1.0), (0.0, 1.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.0), (0.1, 0.0),
    (1.0, 0.0), (1.0, 1.0), (1.0, -1.0),
)  # fmt: skip
"""Commanded speed as a share of the robot's fastest, forward or, below 0, backward; and yaw rate as a share of its
fastest turn, to the left."""
STOP_AND_GO = ((0.8, 0.0), (1.0, 0.0, -1.0))
"""Commanded speeds in turn, as shares of the robot's fastest as in COMMANDS, straight on."""
HOLD = 2.0
"""Time for which each of them is held [s]."""
UNITS = {"upright": "1", "speed_off": "m/s", "speed": "m/s", "yaw_rate": "rad/s"}


def commands_of(robot: Robot) -> list[tuple[float, float]]:
    """COMMANDS in m/s and rad/s."""
    return [(_speed(robot, share), turn * robot.require_legs().yaw_rate) for share, turn in COMMANDS]


def told(robot: Robot, seconds: float) -> dict[str, Commands | Timetable]:
    """What the robot is told in walks of so many seconds, by its name: COMMANDS, then STOP_AND_GO."""
    steady = {"told {:.3g} m/s {:.3g} rad/s".format(*each): Commands.steady(*each) for each in commands_of(robot)}
    return steady | dict(_stop_and_go(robot, shares, seconds) for shares in STOP_AND_GO)


def _stop_and_go(robot: Robot, shares: Sequence[float], seconds: float) -> tuple[str, Timetable]:
    speeds = [_speed(robot, share) for share in shares]
    count = math.ceil(seconds / HOLD)
    rows = tuple((HOLD * number, speeds[number % len(speeds)], 0.0) for number in range(count))
    return f"told {', '.join(f'{speed:.3g}' for speed in speeds)} m/s in turn", Timetable(rows)


def _speed(robot: Robot, share: float) -> float:
    """[m/s] of a share of the fastest, forward or, below 0, backward."""
    slowest, fastest = robot.require_legs().forward
    return share * (fastest if share > 0.0 else -slowest)


def followed(robot: Robot, episodes: Sequence[Episode], steps: int) -> dict[str, float]:
    """Over walks of one command or schedule: the share without a fall; of these walks three means.

    speed_off is that of |filtered speed - command in force| over the whole walk [m/s], see `Episode.speed_error`; speed
    [m/s] and yaw_rate [rad/s] are those of the way along the heading and of the turn over time.
    """
    whole = [each for each in episodes if completed(each, steps)]
    found = {"upright": len(whole) / len(episodes)}
    if whole:
        found["speed_off"] = float(np.mean([each.speed_error for each in whole]))
        rates = [_rates(robot, each) for each in whole]
        found |= dict(zip(("speed", "yaw_rate"), map(float, np.mean(rates, axis=0)), strict=True))
    return found


def _rates(robot: Robot, episode: Episode) -> tuple[float, float]:
    """Speed along the heading [m/s] and yaw rate [rad/s] after the first second."""
    qpos = episode.trace[round(WARM_UP / robot.control_dt) :]
    yaw = headings(qpos)
    time = robot.control_dt * (len(qpos) - 1)
    return distance_along_heading(qpos[:, :2], yaw) / time, float(yaw[-1] - yaw[0]) / time


def rows_of(place: str, name: str, seed: int, found: dict[str, float]) -> Iterator[Result]:
    """The measures of one policy, told what has this name in `told`."""
    for measure, value in found.items():
        yield Result(TURNS + measure, UNITS[measure], value, motors=place, part=name, seed=seed)
