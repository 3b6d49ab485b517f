"""The Pupper as URDF text (PyBullet and others), generated from the same spec.py as the MJCF.

Load it in PyBullet with URDF_USE_INERTIA_FROM_FILE, or inertias are recomputed from the shapes.
"""

from __future__ import annotations

import numpy as np

from motorprior.robots.model_source import ROTOR_GEAR_RATIO
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.mjcf import _vector
from motorprior.robots.pupper_v2.spec import Link

NO_LOAD_SPEED = 52.0  # speed limit of the joints [rad/s]: about 500 rpm at 24 V; assumption
ROTOR_MASS = 1e-6  # [kg]; the links include the rotors' masses


def _link(name: str, link: Link, leg: str | None, collision: str) -> str:
    com = link.com if leg is None else spec.mirrored(link.com, leg)
    ixx, iyy, izz = link.inertia
    return f"""
  <link name="{name}">
    <inertial><origin xyz="{_vector(com)}"/><mass value="{link.mass:.9g}"/>
      <inertia ixx="{ixx:.9g}" ixy="0" ixz="0" iyy="{iyy:.9g}" iyz="0" izz="{izz:.9g}"/></inertial>
    {collision}
  </link>"""


def _joint(leg: str, joint: str, parent: str, child: str, origin: tuple[float, ...], axis: str) -> str:
    index = spec.JOINT_NAMES.index(f"{leg}_{joint}")
    return f"""
  <joint name="{leg}_{joint}" type="revolute">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="{_vector(origin)}"/><axis xyz="{axis}"/>
    <limit lower="{spec.JOINT_LOWER[index]:.9g}" upper="{spec.JOINT_UPPER[index]:.9g}"
      effort="{spec.TORQUE_LIMIT:.9g}" velocity="{NO_LOAD_SPEED:.9g}"/>
  </joint>"""


def _collision(shape: str, xyz: tuple[float, float, float]) -> str:
    return f'<collision><origin xyz="{_vector(xyz)}"/><geometry>{shape}</geometry></collision>'


def _rotor(leg: str, joint: str, parent: str, origin: tuple[float, ...], axis: str, inertia: float) -> str:
    """A rotor on the parent link, about the joint's axis; PyBullet gears it to the joint."""
    name = f"{leg}_{joint}_rotor"
    return (
        _link(name, Link(ROTOR_MASS, (0.0, 0.0, 0.0), (inertia, inertia, inertia)), None, "")
        + f"""
  <joint name="{name}" type="continuous">
    <parent link="{parent}"/><child link="{name}"/><origin xyz="{_vector(origin)}"/><axis xyz="{axis}"/>
  </joint>"""
    )


def _leg(leg: str, armature: np.ndarray) -> str:
    foot = _collision(f'<sphere radius="{spec.FOOT_RADIUS}"/>', spec.mirrored(spec.FOOT_OFFSET, leg))
    links = _link(f"{leg}_abduction_link", spec.ABDUCTION_LINK, leg, "")
    links += _link(f"{leg}_thigh", spec.THIGH, leg, "") + _link(f"{leg}_shank", spec.SHANK, leg, foot)
    origins = (
        spec.abduction_origin(leg),
        spec.mirrored(spec.HIP_OFFSET, leg),
        spec.mirrored(spec.KNEE_OFFSET, leg),
    )
    chain = ("chassis", f"{leg}_abduction_link", f"{leg}_thigh", f"{leg}_shank")
    axes = ("1 0 0", "0 1 0", "0 1 0")
    for index, joint in enumerate(spec.JOINTS_PER_LEG):
        links += _joint(leg, joint, chain[index], chain[index + 1], origins[index], axes[index])
        reflected = float(armature[spec.JOINT_NAMES.index(f"{leg}_{joint}")])
        if reflected > 0.0:
            inertia = reflected / ROTOR_GEAR_RATIO**2
            links += _rotor(leg, joint, chain[index], origins[index], axes[index], inertia)
    return links


def urdf(armature: np.ndarray | None = None, com_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """URDF of the robot with the masses, inertias and limits of spec.py.

    URDF has no reflected inertia. For positive ``armature`` the joint gets a second one, ``<leg>_<joint>_rotor``, on
    the same parent and axis, whose link is the rotor: inertia armature/ratio², to be geared ratio:1 to the joint. Its
    kinetic energy is ½·armature·(joint_vel + ω/ratio)², with the parent's rotation ω; for a high ratio that is MuJoCo's
    ½·armature·joint_vel².

    Args:
        armature: (12,) [kg·m²]; zero if not given.
        com_shift: added to the chassis' centre of mass [m].
    """
    size, plain = _vector(spec.CHASSIS_BOX_SIZE), spec.CHASSIS
    com = (plain.com[0] + com_shift[0], plain.com[1] + com_shift[1], plain.com[2] + com_shift[2])
    body = Link(plain.mass, com, plain.inertia)
    chassis = _link("chassis", body, None, _collision(f'<box size="{size}"/>', spec.CHASSIS_BOX_CENTER))
    rotors = np.zeros(spec.NUM_JOINTS) if armature is None else armature
    legs = "".join(_leg(leg, rotors) for leg in spec.LEGS)
    return f'<?xml version="1.0"?>\n<robot name="{spec.ROBOT_NAME}">{chassis}{legs}\n</robot>\n'
