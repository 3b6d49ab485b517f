"""Commands at given times: the same in every episode."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.robots.robot import Robot


@dataclass(frozen=True)
class Timetable:
    """Attributes: rows, each of time [s], speed [m/s] and yaw rate [rad/s], held until the next; times increase."""

    rows: tuple[tuple[float, float, float], ...]

    def schedule(self, robot: Robot, seed: int, steps: int) -> np.ndarray:
        """(steps, 2) speed [m/s] and yaw rate [rad/s] in every control step; nothing depends on the seed.

        Before the time of the first row the robot stands still.
        """
        table = np.array([(-np.inf, 0.0, 0.0), *self.rows])
        time = robot.control_dt * np.arange(steps)
        row = np.searchsorted(table[:, 0], time + 1e-6 * robot.control_dt, side="right") - 1
        return np.ascontiguousarray(table[row, 1:])
