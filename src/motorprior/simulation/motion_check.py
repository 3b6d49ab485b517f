"""Check of a planned motion in the robot's model: collisions, and the space that is free."""

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


class Obstacle(NamedTuple):
    """Why a pose is not free."""

    problem: str
    remedy: str
    argument: str  # that the remedy changes


class PoseCheck:
    """Whether poses are free: no collision, and no link outside of the free space.

    Links that are neighbours, or touch in the pose ``start``, are not checked against each other.
    The table is the plane on which a fixed base stands. Links are taken to be as large as the
    spheres around their shapes when their distance from the base is computed.

    Attributes:
        pairs: pairs of shapes that must keep their distance.
        radius: largest distance of a link from the base so far [m].

    Args:
        robot: a robot with a fixed base; one with a free base is suspended.
        start: (n,) a free pose [rad].
        free_space: largest allowed distance of a link from the base [m]; None: any.
    """

    def __init__(self, robot: Robot, start: np.ndarray, free_space: float | None = None):
        self._model = build_model(robot, suspended=robot.base == "free")
        self._data = mujoco.MjData(self._model)
        self._free_space = np.inf if free_space is None else free_space
        self._floor = self._model.geom(FLOOR).id
        self._links = np.flatnonzero(np.arange(self._model.ngeom) != self._floor)
        self.radius = 0.0
        self._move(start)
        self._base = self._data.xpos[1].copy()  # body 0 is the world
        self.pairs = self._separate_pairs()

    def obstacle(self, pose: np.ndarray, above_table: float = CLEARANCE) -> Obstacle | None:
        """What a pose (n,) [rad] collides with; None if it is free.

        ``above_table`` is the smallest distance from the table [m].
        """
        self._move(pose)
        for first, second in self.pairs:
            clearance = above_table if self._floor in (first, second) else CLEARANCE
            if self._distance(first, second, clearance) < clearance:
                problem = f"{self._name(first)} comes closer than {1e3 * clearance:g} mm to "
                problem += self._name(second)
                return Obstacle(problem, "give a smaller amplitude", "amplitude")

        far = self._data.geom_xpos[self._links] - self._base
        distances = np.linalg.norm(far, axis=1) + self._model.geom_rbound[self._links]
        self.radius = max(self.radius, float(distances.max()))
        if distances.max() > self._free_space:
            link = int(self._links[np.argmax(distances)])
            problem = f"{self._name(link)} comes {distances.max():.2f} m away from the base"
            return Obstacle(problem, "give more free space, or a smaller amplitude", "free_space")
        return None

    def _separate_pairs(self) -> list[tuple[int, int]]:
        bodies = self._model.geom_bodyid
        parents = self._model.body_parentid
        pairs = []
        for first, second in combinations(range(self._model.ngeom), 2):
            are_neighbours = (
                bodies[first] == bodies[second]
                or parents[bodies[first]] == bodies[second]
                or parents[bodies[second]] == bodies[first]
            )
            # links stand on the floor, which is no link
            if are_neighbours and self._floor not in (first, second):
                continue
            if self._distance(first, second, CLEARANCE) >= CLEARANCE:
                # messages name the table last
                pairs.append((second, first) if first == self._floor else (first, second))
        return pairs

    def _move(self, pose: np.ndarray) -> None:
        self._data.qpos[:] = pose
        mujoco.mj_kinematics(self._model, self._data)

    def _distance(self, first: int, second: int, clearance: float) -> float:
        limit = 2.0 * clearance
        return float(mujoco.mj_geomDistance(self._model, self._data, first, second, limit, None))

    def _name(self, geom: int) -> str:
        if geom == self._floor:
            return "the table"
        return str(self._model.body(self._model.geom_bodyid[geom]).name)


def require_free_motion(
    robot: Robot, parts: Sequence[MotionPart], period: float, free_space: float | None = None
) -> PoseCheck:
    """Check all parts, and return the check with what it saw.

    Joints are taken to be at their targets, ``period`` [s] apart. ``free_space`` as in `PoseCheck`.

    Raises:
        ConfigError: a pose that is not free; names part, time and bodies.
    """
    check = PoseCheck(robot, parts[0].targets[0], free_space)
    stride = max(1, round(_CHECK_PERIOD / period))
    for part in parts:
        for step in range(0, len(part.targets), stride):
            obstacle = check.obstacle(part.targets[step])
            if obstacle is not None:
                raise ConfigError(
                    f"{part.name}: {obstacle.problem} after {step * period:.1f} s",
                    remedy=obstacle.remedy,
                    argument=obstacle.argument,
                )
    return check
