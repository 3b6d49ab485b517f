"""A user's legged robot as URDF text for PyBullet.

Only spheres of the feet have collisions. Load the text with URDF_USE_INERTIA_FROM_FILE, or PyBullet
recomputes inertias from the shapes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from motorprior.robots.urdf_rotor import rotor_element
from motorprior.robots.user_model import read_spec
from motorprior.rotations import roll_pitch_yaw


def user_urdf(
    path: Path,
    feet: Sequence[str],
    armature: np.ndarray | None = None,
    com_shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> str:
    """URDF of the model file of a robot with a free base.

    Args:
        path: MJCF or URDF.
        feet: names of geoms, links or bodies, as for `read_spec`.
        armature: (joints,) reflected inertias of rotors, see `rotor_element` [kg·m²].
        com_shift: added to the base's centre of mass [m].
    """
    spec = read_spec(path, True, feet)
    spec.compiler.fusestatic = True  # every link but the base then has one joint
    model = spec.compile()
    reflected = np.zeros(model.njnt - 1) if armature is None else armature

    elements = [_link(model, 1, np.array(com_shift), feet)]
    for joint in range(1, model.njnt):
        body = int(model.jnt_bodyid[joint])
        elements.append(_link(model, body, np.zeros(3), feet))
        elements.append(_joint(model, joint, float(reflected[joint - 1])))
    return f'<robot name="robot">{"".join(elements)}\n</robot>'


def _link(model: Any, body: int, com_shift: np.ndarray, feet: Sequence[str]) -> str:
    """A link, with its frame at its joint."""
    com = model.body_ipos[body] - _origin(model, body) + com_shift
    moments = model.body_inertia[body]
    collisions = ""
    for foot in feet:
        geom = model.geom(foot).id
        if model.geom_bodyid[geom] == body:
            place = _origin_element(model.geom_pos[geom] - _origin(model, body))
            sphere = f'<sphere radius="{model.geom_size[geom, 0]:.9g}"/>'
            collisions += f"\n    <collision>{place}<geometry>{sphere}</geometry></collision>"
    return f"""
  <link name="{_name(body)}">
    <inertial>{_origin_element(com, model.body_iquat[body])}
      <mass value="{model.body_mass[body]:.9g}"/>
      <inertia ixx="{moments[0]:.9g}" ixy="0" ixz="0" iyy="{moments[1]:.9g}" iyz="0"
        izz="{moments[2]:.9g}"/></inertial>{collisions}
  </link>"""


def _joint(model: Any, joint: int, armature: float) -> str:
    """The joint of a link and its parent, and its rotor."""
    body = int(model.jnt_bodyid[joint])
    parent = int(model.body_parentid[body])
    anchor = np.zeros(3)
    mujoco.mju_rotVecQuat(anchor, model.jnt_pos[joint], model.body_quat[body])
    position = model.body_pos[body] + anchor - _origin(model, parent)

    # the model's angles count from its reference pose
    axis = model.jnt_axis[joint]
    reference = np.zeros(4)
    mujoco.mju_axisAngle2Quat(reference, axis, -model.qpos0[model.jnt_qposadr[joint]])
    orientation = np.zeros(4)
    mujoco.mju_mulQuat(orientation, model.body_quat[body], reference)

    name = model.joint(joint).name
    parent_name = _name(parent)
    place = f'{_origin_element(position, orientation)}<axis xyz="{_numbers(axis)}"/>'
    lower, upper = model.jnt_range[joint]
    return f"""
  <joint name="{name}" type="revolute">
    <parent link="{parent_name}"/><child link="{_name(body)}"/>{place}
    <limit lower="{lower:.9g}" upper="{upper:.9g}" effort="1e9" velocity="1e9"/>
  </joint>{rotor_element(name, parent_name, place, armature)}"""


def _name(body: int) -> str:
    return f"link_{body}"  # bodies of an MJCF need no names


def _origin(model: Any, body: int) -> np.ndarray:
    """(3,) origin of a link's frame in its body: the anchor of its hinge [m]."""
    joint = model.body_jntadr[body]
    is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    return model.jnt_pos[joint] if is_hinge else np.zeros(3)


def _origin_element(position: np.ndarray, quaternion: np.ndarray | None = None) -> str:
    if quaternion is None:
        return f'<origin xyz="{_numbers(position)}"/>'
    angles = np.array(roll_pitch_yaw(np.asarray(quaternion, dtype=np.float64)))
    return f'<origin xyz="{_numbers(position)}" rpy="{_numbers(angles)}"/>'


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)
