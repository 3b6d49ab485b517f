"""How policies follow commands to turn, to walk backward, to stand, and to stop and go; part of walking.py."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from motorprior.locomotion.command import Commands, Timetable
from motorprior.results import Result
from motorprior.robots.robot import Robot
from motorprior.simulation.scene import Episode
from motorprior.studies.gait_quality import WARM_UP, completed, distance_along_heading, headings

TURNS = "commanded/"  # prefix of the names of these quantities
# commanded speed and yaw rate over the robot's fastest; forward and left are positive
COMMANDS = (
    (0.6, 1.0), (0.6, -1.0), (0.0, 1.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.0), (0.1, 0.0),
    (1.0, 0.0), (1.0, 1.0), (1.0, -1.0),
)  # fmt: skip
STOP_AND_GO = ((0.8, 0.0), (1.0, 0.0, -1.0))  # schedules of commanded speeds over the fastest, straight on
HOLD = 2.0  # duration of each command in STOP_AND_GO [s]
UNITS = {"upright": "1", "speed_off": "m/s", "speed": "m/s", "yaw_rate": "rad/s"}


def command_cases(robot: Robot, seconds: float) -> dict[str, Commands | Timetable]:
    """COMMANDS and STOP_AND_GO for walks of so many seconds, by their names in figures.json."""
    cases: dict[str, Commands | Timetable] = {}
    for share, turn in COMMANDS:
        forward, yaw_rate = _speed(robot, share), turn * robot.require_legs().yaw_rate
        cases[f"told {forward:.3g} m/s {yaw_rate:.3g} rad/s"] = Commands.steady(forward, yaw_rate)
    for shares in STOP_AND_GO:
        speeds = [_speed(robot, share) for share in shares]
        rows = tuple((HOLD * k, speeds[k % len(speeds)], 0.0) for k in range(math.ceil(seconds / HOLD)))
        cases[f"told {', '.join(f'{speed:.3g}' for speed in speeds)} m/s in turn"] = Timetable(rows)
    return cases


def _speed(robot: Robot, share: float) -> float:
    """Speed [m/s] from a fraction of the fastest, forward if positive."""
    slowest, fastest = robot.require_legs().forward
    return share * (fastest if share > 0.0 else -slowest)


def command_errors(robot: Robot, episodes: Sequence[Episode], steps: int) -> dict[str, float]:
    """Fraction of walks without a fall, and means over these walks.

    speed_off is the mean |filtered speed - command| [m/s], see `Episode.speed_error`; speed [m/s] is the distance along
    the heading over time, and yaw_rate [rad/s] the turn over time.
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


def command_results(place: str, name: str, seed: int, found: dict[str, float]) -> Iterator[Result]:
    """The quantities of `command_errors` for one policy and one of the `command_cases`."""
    for quantity, value in found.items():
        yield Result(TURNS + quantity, UNITS[quantity], value, motors=place, part=name, seed=seed)
