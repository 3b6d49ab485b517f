"""Where the robot's links are: points for pictures of a gait, from kinematics alone."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import mujoco
import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot
from motorprior.simulation.build_model import build_model

_THINNEST = 0.02
"""Half of the least extent of a base that has no geom [m]."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """The robot in F frames, in the world frame: x forward, y left, z up, floor at z = 0.

    Attributes:
        legs: (F, L, 4, 3) [m]; legs × abduction origin, hip axis, knee, foot centre × (x, y, z).
        chassis: (F, 8, 3) [m] corners of the base's box; corner 4a + 2b + c is at the upper end of its x, y
            and z extent where a, b and c are 1.
        is_right: per leg, whether its hip is on the right of the body.
        foot_radius: [m].
        height: of the base in the nominal pose [m], the size of the robot.
    """

    legs: np.ndarray
    chassis: np.ndarray
    is_right: tuple[bool, ...]
    foot_radius: float
    height: float

    def __len__(self) -> int:
        """F."""
        return len(self.legs)

    def frames(self, selection: slice | np.ndarray) -> Skeleton:
        """The frames a slice, a mask (F,) or an index array selects."""
        return replace(self, legs=self.legs[selection], chassis=self.chassis[selection])


def skeleton(robot: Robot, qpos: np.ndarray) -> Skeleton:
    """Forward kinematics of every frame.

    Args:
        robot: a legged one.
        qpos: (F, 7 + joints); base position [m], base quaternion (w, x, y, z), joint angles [rad].

    Raises:
        ConfigError: wrong shape, or a coordinate that is not finite.
    """
    robot.require_legs()
    qpos = _checked(qpos, 7 + robot.num_joints)
    model = build_model(robot)
    data = mujoco.MjData(model)
    bodies, feet = _leg_ids(model, robot)
    corners = _corners(model, data, bodies[:, 0])
    legs, chassis = np.empty((len(qpos), len(robot.legs), 4, 3)), np.empty((len(qpos), 8, 3))
    for frame, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        legs[frame, :, :3] = data.xpos[bodies]
        legs[frame, :, 3] = data.geom_xpos[feet]
        chassis[frame] = data.xpos[1] + corners @ data.xmat[1].reshape(3, 3).T
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    is_right = tuple(bool(y < 0.0) for y in data.xpos[bodies[:, 1], 1])
    return Skeleton(legs, chassis, is_right, robot.legs[0].foot_radius, robot.standing_height)


def _corners(model: mujoco.MjModel, data: mujoco.MjData, legs: np.ndarray) -> np.ndarray:
    """(8, 3) corners of the box of the base's first geom, in the base's frame [m]; one around the legs (L,) if none."""
    ends, box = np.array(list(product((-1.0, 1.0), repeat=3))), model.body(1).geomadr[0]
    if box >= 0:
        turned = np.empty(9)
        mujoco.mju_quat2Mat(turned, model.geom_quat[box])
        return model.geom_pos[box] + (ends * model.geom_size[box]) @ turned.reshape(3, 3).T
    mujoco.mj_kinematics(model, data)
    begun = (data.xpos[legs] - data.xpos[1]) @ data.xmat[1].reshape(3, 3)
    low, high = begun.min(axis=0), begun.max(axis=0)
    return 0.5 * (low + high) + ends * np.maximum(0.5 * (high - low), _THINNEST)


def _leg_ids(model: mujoco.MjModel, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Bodies (L, 3) whose origins are abduction, hip and knee, and the feet's geoms (L,)."""
    names = robot.joint_names
    bodies = [[model.joint(names[joint]).bodyid[0] for joint in leg.joints] for leg in robot.legs]
    return np.array(bodies), np.array([model.geom(leg.foot).id for leg in robot.legs])


def _checked(qpos: np.ndarray, columns: int) -> np.ndarray:
    qpos = np.asarray(qpos, dtype=np.float64)
    if qpos.ndim != 2 or qpos.shape[1] != columns:
        raise ConfigError(
            f"qpos has shape {qpos.shape}, expected (frames, {columns})",
            remedy="give base position, base quaternion and the joint angles per frame",
        )
    bad = np.argwhere(~np.isfinite(qpos))
    if len(bad):
        row, column = bad[0].tolist()
        raise ConfigError(
            f"frame {row}, qpos[{column}] is {qpos[row, column]}, not a finite number",
            remedy="drop the frames after the fault",
        )
    return qpos
