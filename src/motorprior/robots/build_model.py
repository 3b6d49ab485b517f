"""MuJoCo model of a robot: on a flat floor, or with its base fixed.

Explicit foot-floor pairs are the only contacts. Armature, damping and dry friction of the model's
joints are set to 0, since the motors have them. Actuators, sensors, keys, contact pairs, floors and
lights of the model are removed.
"""

from typing import Any

import mujoco

from motorprior.exceptions import ArtifactError
from motorprior.robots.model_source import files_digest
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.robots.user_model import cannot_read, read_spec

CONTACT_TIME = 0.02  # [s] time constant of a foot's contact, MuJoCo's default
CONTACT_DT = 0.001  # [s] longest physics step at which a foot's contact is critically damped
FLOOR = "floor of the simulation"  # name of its geom; a model may have a floor of its own


def build_model(
    robot: Robot, physics_dt: float | None = None, suspended: bool = False
) -> mujoco.MjModel:
    """Compile the model, for steps of ``physics_dt`` [s] or the robot's own.

    ``suspended`` welds a free base to the world, high enough that no foot reaches the floor. Raises
    ArtifactError if a file of the model has changed since the robot was loaded, or it cannot be
    compiled with a floor.
    """
    physics_dt = robot.physics_dt if physics_dt is None else physics_dt
    source = robot.model
    is_complete = all(file.is_file() for file in source.files)
    if not is_complete or files_digest(source.files) != source.sha256:
        problem = "the model is missing or has changed"
        raise ArtifactError(problem, where=source.path, remedy="load the robot again")

    try:
        spec = read_spec(source.path, robot.base == "free", [leg.foot for leg in robot.legs])
        _set_physics(spec, physics_dt)
        if robot.base == "free":
            base = spec.worldbody.first_body()
            height = robot.suspended_height if suspended else robot.standing_height
            base.pos = [0.0, 0.0, height]
            if suspended:
                spec.delete(base.first_joint())
        _add_floor(spec, robot, physics_dt)
        return spec.compile()
    except ValueError as error:
        raise cannot_read(source.path, str(error)) from error


def _set_physics(spec: Any, physics_dt: float) -> None:
    option = spec.option
    option.timestep = physics_dt
    option.gravity = [0.0, 0.0, -GRAVITY]
    # fastest for a robot of this size: Euler with implicit joint damping, dense Jacobian, no
    # constraint islands
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND

    for geom in spec.geoms:
        geom.contype = 0
        geom.conaffinity = 0
    for joint in spec.joints:
        joint.armature = 0.0
        joint.frictionloss = 0.0
        # a number in MuJoCo 3, coefficients of a polynomial in 4
        joint.damping = 0.0 * joint.damping

    planes = [geom for geom in spec.worldbody.geoms if geom.type == mujoco.mjtGeom.mjGEOM_PLANE]
    for element in (*spec.keys, *spec.sensors, *spec.actuators, *spec.pairs, *spec.lights, *planes):
        spec.delete(element)


def _add_floor(spec: Any, robot: Robot, physics_dt: float) -> None:
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    floor = spec.worldbody.add_geom(
        name=FLOOR, type=plane, size=[0, 0, 0.05], rgba=[0.9, 0.9, 0.9, 1]
    )
    floor.contype = 0
    floor.conaffinity = 0

    # With a longer step contacts bounce more. With this damping ratio the trots of the same motors
    # agree at 1 and 2 ms.
    damping = max(1.0, physics_dt / CONTACT_DT)
    friction = [robot.foot_friction, robot.foot_friction, 0.005, 0.0001, 0.0001]
    for leg in robot.legs:
        spec.add_pair(
            geomname1=FLOOR,
            geomname2=leg.foot,
            condim=3,
            friction=friction,
            solref=[CONTACT_TIME, damping],
        )
