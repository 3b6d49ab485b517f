"""Settings of a simulated robot, for any engine."""

from __future__ import annotations

from dataclasses import dataclass

from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot


@dataclass(frozen=True)
class WorldConfig:
    """Settings of a simulated robot.

    Attributes:
        robot: its description.
        physics_dt: step [s]; must divide control_dt.
        control_dt: time a position target is held [s].
        suspended: a free base is fixed in the air.
    """

    robot: Robot
    physics_dt: float
    control_dt: float
    suspended: bool = False

    @classmethod
    def of(
        cls, robot: Robot, *, physics_dt: float | None = None, control_dt: float | None = None, suspended: bool = False
    ) -> WorldConfig:
        """With the robot's own clocks by default."""
        return cls(robot, physics_dt or robot.physics_dt, control_dt or robot.control_dt, suspended)

    @property
    def is_fixed(self) -> bool:
        """Whether the base cannot move."""
        return self.suspended or self.robot.base == "fixed"

    @property
    def substeps(self) -> int:
        """Physics steps per control step; ConfigError if physics_dt does not divide control_dt."""
        count = round(self.control_dt / self.physics_dt)
        if count < 1 or abs(count * self.physics_dt - self.control_dt) > 1e-9:
            raise ConfigError(f"physics_dt {self.physics_dt} s does not divide control_dt {self.control_dt} s")
        return count
