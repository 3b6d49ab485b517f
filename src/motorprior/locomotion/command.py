"""Commanded speed and yaw rate over an episode."""

from dataclasses import dataclass

import numpy as np

from motorprior.bounds import require_number, require_range
from motorprior.locomotion.gait import MAX_COMMAND
from motorprior.robots.robot import Robot

_STREAM = 0xC0DE


@dataclass(frozen=True)
class Commands:
    """Random commands of an episode, each held for a while.

    The speeds spread evenly over their range, in random order.
    """

    forward: tuple[float, float] | None = None
    """Lowest and highest speed [m/s]; if not given the robot's lowest, and 1.2 times its highest,
    as policies fall at the edge of their training range."""
    yaw_rate: tuple[float, float] | None = None
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
    def steady(cls, forward: float, yaw_rate: float = 0.0) -> "Commands":
        """One command [m/s], [rad/s] for the whole episode."""
        return cls((forward, forward), (yaw_rate, yaw_rate), 1e6, 0.0, 0.0)

    def extend_range(self, robot: Robot) -> Robot:
        """The robot with its speed range extended by the commands' range.

        ConfigError for a yaw rate outside the robot's range.
        """
        gait = robot.require_gait()
        if self.yaw_rate is not None:
            require_range("commands.yaw_rate", self.yaw_rate, -gait.yaw_rate, gait.yaw_rate)
        slowest, fastest = gait.forward
        low, high = self.forward or (slowest, fastest)
        return robot.with_speed_range((min(slowest, low), max(fastest, high)))

    def schedule(self, robot: Robot, seed: int, steps: int) -> np.ndarray:
        """(steps, 2) commanded speed [m/s] and yaw rate [rad/s] in the episode of this seed."""
        rng = np.random.default_rng([_STREAM, seed])
        gait = robot.require_gait()
        forward = self.forward or (gait.forward[0], MAX_COMMAND * gait.forward[1])
        turn = self.yaw_rate or (-gait.yaw_rate, gait.yaw_rate)

        steps_per_command = max(1, round(self.hold / robot.control_dt))
        count = -(-steps // steps_per_command)
        shares = (rng.permutation(count) + rng.uniform(size=count)) / count
        speeds = forward[0] + (forward[1] - forward[0]) * shares
        is_straight = rng.uniform(size=count) < self.straight
        turns = np.where(is_straight, 0.0, rng.uniform(*turn, count))
        moving = rng.uniform(size=count) >= self.still
        commands = np.stack([speeds * moving, turns * moving], axis=1)
        return commands[np.arange(steps) // steps_per_command]
