"""The table of a planned motion: what is played, at which angles and under which gravity."""

from collections.abc import Sequence

import numpy as np

from motorprior.logs.loads_dynamics import BodyDynamics
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.robots.servos import MotionPart
from motorprior.texts import text_table

_ANGLES = 21  # of a joint, at which its torque of gravity is computed


def motion_table(robot: Robot, parts: Sequence[MotionPart], period: float) -> str:
    """A row per part: its duration, and angles and torque of gravity of a joint that moves alone.

    Targets are ``period`` [s] apart.
    """
    dynamics = BodyDynamics(
        build_model(robot, suspended=robot.base == "free"), range(robot.num_joints)
    )
    rows = []
    for part in parts:
        cells = [part.name, f"{len(part.targets) * period:.1f} s", "", ""]
        lowest = part.targets.min(axis=0)
        highest = part.targets.max(axis=0)
        (moving,) = np.nonzero(highest > lowest)
        if len(moving) == 1:
            joint = int(moving[0])
            cells[2] = f"{lowest[joint]:+.2f} to {highest[joint]:+.2f} rad"
            poses = np.linspace(lowest, highest, _ANGLES)
            torques = [float(dynamics.gravity_torque(pose)[joint]) for pose in poses]
            cells[3] = f"{min(torques):+.3f} to {max(torques):+.3f} N·m"
        rows.append(cells)
    return text_table(["part", "time", "angle", "torque of gravity"], rows)
