"""How a film and MuJoCo's window look at a robot."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from typing import Any

import mujoco

from motorprior.robots.robot import Robot
from motorprior.simulation.build_model import FLOOR

AZIMUTH, ELEVATION = 105.0, -20.0
"""From the robot's right, a little from the front and from above [°]."""
_DISTANCE, _VIEW = 7.5, 30.0
"""Of the camera [standing heights], and its vertical field of view [°]: the horizon is above the picture, where there
is nothing but black."""
_SHOWN_GROUPS = 3
"""MuJoCo shows geoms of the groups 0, 1 and 2; models often keep what collides in group 3, beside meshes that are
shown."""


def look_at(robot: Robot, camera: Any) -> None:
    """Set angles and distance of an MjvCamera."""
    camera.distance, camera.azimuth, camera.elevation = _DISTANCE * robot.standing_height, AZIMUTH, ELEVATION


def prepare(model: mujoco.MjModel, option: Any) -> None:
    """Set view and light of a model, and the groups of its geoms that an MjvOption shows: all if none of it is seen."""
    model.vis.global_.fovy = _VIEW
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = (0.4, 0.5) if model.nlight else (0.6, 0.8)
    floor = model.geom(FLOOR).id
    seen = [geom for geom in range(model.ngeom) if geom != floor and model.geom_group[geom] < _SHOWN_GROUPS]
    if not seen:
        option.geomgroup[:] = 1
