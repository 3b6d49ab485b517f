"""The robot's model as it is simulated: on a flat floor, or with its base fixed, at a clock.

Explicit foot-floor pairs are the only contacts: knees and body of a robot that goes down pass through the floor until
the episode ends. A longer step leaves more bounce in a contact: its damping ratio grows with the step, so that the same
motors trot alike at 1 and 2 ms (``benchmarks/floors.py``). Constraint islands are off, the Jacobian dense and the
integrator Euler with implicit joint damping, which is fastest for a robot of this size. Armature, damping and dry
friction of the joints are the motors', so the model's own are taken out, with its contact pairs and its sensors.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from typing import Any

import mujoco

from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.robots.model_source import GeneratedModel, files_digest
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.robots.user_model import cannot_read

CONTACT_TIME = 0.02
"""Time constant of a foot's contact [s], MuJoCo's default."""
CONTACT_DT = 0.001
"""Longest physics step at which a foot's contact is critically damped [s]."""
FLOOR = "floor of the simulation"
"""Name of its geom; a model may have a floor of its own."""


def build_model(robot: Robot, physics_dt: float | None = None, suspended: bool = False) -> mujoco.MjModel:
    """The compiled model.

    Args:
        robot: whose model.
        physics_dt: step [s]; the robot's own by default.
        suspended: weld a free base to the world, high enough that no foot reaches the floor.

    Raises:
        ConfigError: a robot with a fixed base cannot be suspended.
        ArtifactError: a file of the model is gone, or not as it was when the robot was loaded; or the model cannot be
            compiled with a floor and without actuators.
    """
    if suspended and robot.base == "fixed":
        raise ConfigError(f"robot {robot.name!r} has a fixed base", remedy="use suspended=False")
    try:
        return _built(robot, robot.physics_dt if physics_dt is None else physics_dt, suspended)
    except ValueError as error:
        where = None if isinstance(robot.model, GeneratedModel) else robot.model.path
        raise cannot_read(where, str(error)) from error


def _built(robot: Robot, physics_dt: float, suspended: bool) -> mujoco.MjModel:
    spec = _read(robot)
    option = spec.option
    option.timestep, option.gravity = physics_dt, [0.0, 0.0, -GRAVITY]
    option.integrator, option.jacobian = mujoco.mjtIntegrator.mjINT_EULER, mujoco.mjtJacobian.mjJAC_DENSE
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for joint in spec.joints:
        joint.armature = joint.frictionloss = 0.0
        joint.damping = 0.0 * joint.damping  # a number in MuJoCo 3, coefficients of a polynomial in 4
    for element in (*spec.keys, *spec.sensors, *spec.actuators, *spec.pairs):
        spec.delete(element)
    if robot.base == "free":
        _place(spec, robot, suspended)
    _add_floor(spec, robot, physics_dt)
    return spec.compile()


def _read(robot: Robot) -> Any:
    source = robot.model
    if isinstance(source, GeneratedModel):
        return mujoco.MjSpec.from_string(source.mjcf())
    if not all(file.is_file() for file in source.files) or files_digest(source.files) != source.sha256:
        raise ArtifactError("the model is gone or has changed", where=source.path, remedy="load the robot again")
    return mujoco.MjSpec.from_file(str(source.path))


def _place(spec: Any, robot: Robot, suspended: bool) -> None:
    """Stand on the floor, or hang in the air without a free joint."""
    base = spec.worldbody.first_body()
    base.pos = [0.0, 0.0, robot.suspended_height if suspended else robot.standing_height]
    if suspended:
        spec.delete(base.first_joint())


def _add_floor(spec: Any, robot: Robot, physics_dt: float) -> None:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floor = spec.worldbody.add_geom(name=FLOOR, type=plane, size=[0, 0, 0.05], rgba=[0.9, 0.9, 0.9, 1])
    floor.contype = floor.conaffinity = 0
    damping = max(1.0, physics_dt / CONTACT_DT)
    friction = [robot.foot_friction, robot.foot_friction, 0.005, 0.0001, 0.0001]
    for leg in robot.legs:
        spec.add_pair(geomname1=FLOOR, geomname2=leg.foot, condim=3, friction=friction, solref=[CONTACT_TIME, damping])
