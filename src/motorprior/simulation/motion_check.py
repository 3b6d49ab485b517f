"""Check of a planned motion in the robot's model: collisions with itself and with the table."""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.build_model import FLOOR, build_model
from motorprior.robots.robot import Robot
from motorprior.robots.servos import MotionPart

CLEARANCE = 0.005  # smallest distance of two links, or of a link and the table [m]
_CHECK_PERIOD = 0.02  # time between two checked poses [s]


class Collision(NamedTuple):
    """Two bodies that come too close."""

    part: str  # name of the part of the motion
    time: float  # since its beginning [s]
    first: str  # names of the bodies
    second: str


def require_free_motion(robot: Robot, parts: Sequence[MotionPart], period: float) -> int:
    """Check all parts; returns the number of pairs of bodies that were checked.

    Joints are taken to be at their targets, ``period`` [s] apart. The table is the plane on which a
    fixed base stands. Links that touch at the beginning of the motion, such as neighbours, are not
    checked against each other.

    Raises:
        ConfigError: a collision; names part, time and bodies.
    """
    model = build_model(robot)
    data = mujoco.MjData(model)
    pairs = _pairs(model, data, robot, parts[0].targets[0])
    stride = max(1, round(_CHECK_PERIOD / period))
    for part in parts:
        for step in range(0, len(part.targets), stride):
            pair = _collision(model, data, robot, part.targets[step], pairs)
            if pair is not None:
                collision = Collision(part.name, step * period, *pair)
                raise ConfigError(
                    f"{collision.part}: {collision.first} comes closer than "
                    f"{1e3 * CLEARANCE:g} mm to {collision.second} after {collision.time:.1f} s",
                    remedy="give a smaller amplitude",
                    argument="amplitude",
                )
    return len(pairs)


def _pairs(
    model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, start: np.ndarray
) -> list[tuple[int, int]]:
    """Geoms that must keep their distance: those that do so at the start."""
    _pose(model, data, robot, start)
    bodies = model.geom_bodyid
    floor = model.geom(FLOOR).id
    pairs = []
    for first, second in combinations(range(model.ngeom), 2):
        are_neighbours = (
            bodies[first] == bodies[second]
            or model.body_parentid[bodies[first]] == bodies[second]
            or model.body_parentid[bodies[second]] == bodies[first]
        )
        # links stand on the floor, which is no link
        if are_neighbours and floor not in (first, second):
            continue
        if _distance(model, data, first, second) >= CLEARANCE:
            pairs.append((first, second))
    return pairs


def _collision(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    robot: Robot,
    pose: np.ndarray,
    pairs: Sequence[tuple[int, int]],
) -> tuple[str, str] | None:
    """Names of the first two bodies that are too close in a pose."""
    _pose(model, data, robot, pose)
    for first, second in pairs:
        if _distance(model, data, first, second) < CLEARANCE:
            return _name(model, first), _name(model, second)
    return None


def _pose(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, pose: np.ndarray) -> None:
    data.qpos[model.nq - robot.num_joints :] = pose
    mujoco.mj_kinematics(model, data)


def _distance(model: mujoco.MjModel, data: mujoco.MjData, first: int, second: int) -> float:
    return float(mujoco.mj_geomDistance(model, data, first, second, 2.0 * CLEARANCE, None))


def _name(model: mujoco.MjModel, geom: int) -> str:
    if model.geom(geom).name == FLOOR:
        return "the table"
    return str(model.body(model.geom_bodyid[geom]).name)
