"""Clearance, sliding and position of the feet, from the states of a walk."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from motorprior.robots.build_model import build_model
from motorprior.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class FootMotion:
    """(F, L) arrays over frames and feet."""

    clearance: np.ndarray  # height of the foot's lowest point [m]
    sliding: np.ndarray  # horizontal speed of that point [m/s]
    ahead: np.ndarray  # position of the foot's centre along the body's x axis, from the base [m]


def foot_motion(robot: Robot, qpos: np.ndarray, qvel: np.ndarray) -> FootMotion:
    """Forward kinematics of every frame.

    The lowest point of a foot of radius r moves with v + ω × (0, 0, -r): a foot that rolls does not slide.
    qpos is (F, 7 + joints), qvel (F, 6 + joints).
    """
    model = build_model(robot)
    data, velocity = mujoco.MjData(model), np.zeros(6)
    feet = [(model.geom(leg.foot).id, leg.foot_radius) for leg in robot.legs]
    clearance, sliding, ahead = np.zeros((3, len(qpos), len(feet)))
    base = model.body(model.jnt_bodyid[0]).id
    for frame in range(len(qpos)):
        data.qpos[:], data.qvel[:] = qpos[frame], qvel[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        forward = data.xmat[base, ::3]
        for column, (geom, radius) in enumerate(feet):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, velocity, 0)
            clearance[frame, column] = data.geom_xpos[geom, 2] - radius
            ahead[frame, column] = forward @ (data.geom_xpos[geom] - data.xpos[base])
            across = velocity[3] - velocity[1] * radius, velocity[4] + velocity[0] * radius
            sliding[frame, column] = np.hypot(*across)
    return FootMotion(clearance, sliding, ahead)
