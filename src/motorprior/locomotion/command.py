"""Commanded speed and yaw rate over an episode: sampled for every episode, or given at fixed times."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from motorprior.bounds import require_number, require_range
from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import MAX_COMMAND
from motorprior.logs.tables import table_columns
from motorprior.robots.robot import Robot

_STREAM = 0xC0DE
COLUMNS = ("time_s", "forward_m_s", "yaw_rate_rad_s")  # of a timetable's file
Range = tuple[float, float]


@dataclass(frozen=True)
class Commands:
    """Random commands of an episode, each held for a while; speeds spread evenly over their range, in random order.

    Raises:
        ConfigError: a range whose first number is larger, or a number out of bounds.
    """

    forward: Range | None = None
    """Lowest and highest speed [m/s]; if not given the robot's lowest, and 1.2 times its highest, as policies fall at
    the edge of their training range."""
    yaw_rate: Range | None = None
    """Lowest and highest yaw rate [rad/s], to the left; the robot's own range if not given."""
    hold: float = 2.5  # duration of a command [s]
    straight: float = 0.5  # share of the commands without a turn [-]
    still: float = 0.1  # share of the commands to stand still [-]

    def __post_init__(self) -> None:
        for name in ("forward", "yaw_rate"):
            if getattr(self, name) is not None:
                require_range(f"commands.{name}", getattr(self, name), -10.0, 10.0)
        require_number("commands.hold", self.hold, 0.1, 1e6)
        for name in ("straight", "still"):
            require_number(f"commands.{name}", getattr(self, name), 0.0, 1.0)

    @classmethod
    def steady(cls, forward: float, yaw_rate: float = 0.0) -> Commands:
        """One command [m/s], [rad/s] for the whole episode."""
        return cls((forward, forward), (yaw_rate, yaw_rate), 1e6, 0.0, 0.0)

    def extend_range(self, robot: Robot) -> Robot:
        """The robot with its speed range extended by theirs; ConfigError for a yaw rate outside its range."""
        limit, (slowest, fastest) = robot.require_legs().yaw_rate, robot.require_legs().forward
        if self.yaw_rate is not None:
            require_range("commands.yaw_rate", self.yaw_rate, -limit, limit)
        low, high = self.forward or (slowest, fastest)
        return robot.with_speed_range((min(slowest, low), max(fastest, high)))

    def schedule(self, robot: Robot, seed: int, steps: int) -> np.ndarray:
        """(steps, 2) speed [m/s] and yaw rate [rad/s] in every control step of the episode of this seed."""
        rng, size = np.random.default_rng([_STREAM, seed]), robot.require_legs()
        forward = self.forward or (size.forward[0], MAX_COMMAND * size.forward[1])
        turn = self.yaw_rate or (-size.yaw_rate, size.yaw_rate)
        each = max(1, round(self.hold / robot.control_dt))
        count = -(-steps // each)
        shares = (rng.permutation(count) + rng.uniform(size=count)) / count
        speeds = forward[0] + (forward[1] - forward[0]) * shares
        turns = np.where(rng.uniform(size=count) < self.straight, 0.0, rng.uniform(*turn, count))
        moving = rng.uniform(size=count) >= self.still
        commands = np.stack([speeds * moving, turns * moving], axis=1)
        return commands[np.arange(steps) // each]


@dataclass(frozen=True)
class Timetable:
    """Rows of time [s], speed [m/s] and yaw rate [rad/s], each held until the next; the same in every episode."""

    rows: tuple[tuple[float, float, float], ...]

    @classmethod
    def read(cls, path: Path, robot: Robot) -> Timetable:
        """Read a CSV file with `COLUMNS`; each command is in force until the time of the next row.

        Raises:
            LogError: the file cannot be read.
            ConfigError: times that do not increase from 0 on, or a command outside the robot's range; names the row.
        """
        size, before = robot.require_legs(), -inf
        bounds = (0.0, inf), size.forward, (-size.yaw_rate, size.yaw_rate)
        columns = [column.tolist() for column in table_columns(path, COLUMNS).values()]
        rows = list(zip(*columns, strict=True))
        for number, row in enumerate(rows):
            for name, value, (low, high) in zip(COLUMNS, row, bounds, strict=True):
                if not low <= value <= high or (name == COLUMNS[0] and value <= before):
                    problem = f"row {number}: {name} is {value:g}, but must be within {low:g} to {high:g}"
                    remedy = f"give commands in the range of robot {robot.name!r}, and times that increase"
                    raise ConfigError(problem, where=path, remedy=remedy)
            before = row[0]
        return cls(tuple(rows))

    def schedule(self, robot: Robot, seed: int, steps: int) -> np.ndarray:
        """(steps, 2) speed [m/s] and yaw rate [rad/s] in every control step, 0 before the first row; no randomness."""
        table = np.array([(-np.inf, 0.0, 0.0), *self.rows])
        time = robot.control_dt * np.arange(steps)
        row = np.searchsorted(table[:, 0], time + 1e-6 * robot.control_dt, side="right") - 1
        return np.ascontiguousarray(table[row, 1:])
