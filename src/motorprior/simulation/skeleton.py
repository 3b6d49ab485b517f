"""Stick figures: lines between the joints of a robot, by kinematics alone."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot


def skeleton(robot: Robot) -> Callable[[np.ndarray], np.ndarray]:
    """A function from a qpos (7 + joints,) to the ends (N, 2, 3) of N lines [m] in the world frame.

    Lines from each body's parent to the body, then from the last body of each leg to its foot.
    """
    model = build_model(robot)
    data = mujoco.MjData(model)
    bodies = np.array([body for body in range(1, model.nbody) if model.body_parentid[body]])
    parents = model.body_parentid[bodies]
    feet = np.array([model.geom(leg.foot).id for leg in robot.legs], dtype=int)

    def lines(qpos: np.ndarray) -> np.ndarray:
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        links = np.stack([data.xpos[parents], data.xpos[bodies]], axis=1)
        soles = np.stack([data.xpos[model.geom_bodyid[feet]], data.geom_xpos[feet]], axis=1)
        return np.concatenate([links, soles])

    return lines
