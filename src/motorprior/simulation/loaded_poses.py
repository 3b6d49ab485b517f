"""Poses of an arm in which gravity loads its joints, for recordings that identify motors."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from motorprior.logs.loads_dynamics import BodyDynamics
from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot
from motorprior.simulation.motion_check import PoseCheck

_CANDIDATES = 2000
_STREAM = 0x10AD
_ANGLES = 3  # of the joint, at which its torque of gravity is computed
# A pose other than the nominal one takes time, so its range of gravity torque must be larger by
# this factor and by this torque [N·m].
_MIN_FACTOR = 1.2
_MIN_TORQUE = 0.01
# share of the largest range at which the pose of an earlier joint serves this one, too
_GOOD_ENOUGH = 0.8
# A proportional control sags under the load: distance from the table [m].
_ABOVE_TABLE = 0.04
# share of its range of gravity torque that a pose may lose so that another joint stays nominal
_SAME = 0.98
_PATH_STEP = 0.05  # largest change of a joint between two checked poses [rad]


def loaded_poses(
    robot: Robot,
    lower: np.ndarray,
    upper: np.ndarray,
    nominal: np.ndarray,
    reach: np.ndarray,
    free_space: float | None = None,
) -> np.ndarray:
    """(n, n) for each joint the pose in which its motion changes the torque of gravity most.

    Row j is the pose [rad] about which joint j moves by ±reach[j] while the others hold. It is the
    best of random poses whose motion, and straight path from the nominal pose, are free of
    collisions and inside the free space. The nominal pose stays where no pose is clearly better.

    Args:
        robot: with a fixed base; one with a free base is suspended.
        lower: (n,) smallest angles of a pose [rad].
        upper: (n,) largest angles of a pose [rad].
        nominal: (n,) nominal pose [rad], which is free.
        reach: (n,) amplitude of each joint [rad].
        free_space: see `PoseCheck`.
    """
    rng = np.random.default_rng(_STREAM)
    poses = np.concatenate([[nominal], rng.uniform(lower, upper, (_CANDIDATES, len(nominal)))])
    check = PoseCheck(robot, nominal, free_space)
    dynamics = BodyDynamics(
        build_model(robot, suspended=robot.base == "free"), range(robot.num_joints)
    )

    poses_of_joints = np.tile(nominal, (len(nominal), 1))
    for joint in range(len(nominal)):
        loads = _JointLoads(check, dynamics, nominal, joint, reach)
        ranges = np.array([loads.gravity_range(pose) for pose in poses])
        min_range = max(_MIN_FACTOR * ranges[0], ranges[0] + _MIN_TORQUE)
        candidates = (poses[index] for index in np.argsort(-ranges) if ranges[index] > min_range)
        best = next((pose for pose in candidates if loads.is_free(pose)), nominal)

        # with the pose of an earlier joint, the arm need not move to another one
        min_shared_range = max(min_range, _GOOD_ENOUGH * loads.gravity_range(best))
        shared = (
            pose
            for pose in poses_of_joints[:joint]
            if loads.gravity_range(pose) >= min_shared_range and loads.is_free(pose)
        )
        poses_of_joints[joint] = next(shared, loads.simplified(best))
    return poses_of_joints


class _JointLoads(NamedTuple):
    """One joint that moves by ±reach about poses while the others hold."""

    check: PoseCheck
    dynamics: BodyDynamics
    nominal: np.ndarray
    joint: int
    reach: np.ndarray

    def gravity_range(self, pose: np.ndarray) -> float:
        """Range of the torque of gravity on the joint [N·m]."""
        torques = []
        for away in np.linspace(-1.0, 1.0, _ANGLES):
            moved = self._moved(pose, away)
            torques.append(self.dynamics.gravity_torque(moved)[self.joint])
        return max(torques) - min(torques)

    def is_free(self, pose: np.ndarray) -> bool:
        """Whether the path from the nominal pose and the motion there are free."""
        corners = [self.nominal, pose, self._moved(pose, -1.0), self._moved(pose, 1.0)]
        return all(self.check.obstacle(point, _ABOVE_TABLE) is None for point in _path(corners))

    def simplified(self, pose: np.ndarray) -> np.ndarray:
        """The pose with all joints at their nominal angles whose angles matter little."""
        min_range = _SAME * self.gravity_range(pose)
        for other in range(len(pose)):
            changed = pose.copy()
            changed[other] = self.nominal[other]
            if self.gravity_range(changed) >= min_range and self.is_free(changed):
                pose = changed
        return pose

    def _moved(self, pose: np.ndarray, share: float) -> np.ndarray:
        moved = pose.copy()
        moved[self.joint] += share * self.reach[self.joint]
        return moved


def _path(corners: Sequence[np.ndarray]) -> np.ndarray:
    """(N, n) points on the straight lines between poses."""
    lines = []
    for begin, end in pairwise(corners):
        count = 2 + int(np.abs(end - begin).max() / _PATH_STEP)
        lines.append(np.linspace(begin, end, count))
    return np.concatenate(lines)
