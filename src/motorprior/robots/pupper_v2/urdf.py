"""The Pupper as URDF text for PyBullet, from pupper_v2.urdf.

That file has the masses and limits of pupper_v2.xml. Load the text in PyBullet with
URDF_USE_INERTIA_FROM_FILE, or inertias are recomputed from the shapes.
"""

import re
from pathlib import Path

import numpy as np

from motorprior.robots.model_source import ROTOR_GEAR_RATIO

_FILE = Path(__file__).with_name("pupper_v2.urdf")
# the first link
_CHASSIS_COM = re.compile(r'(?<=<link name="chassis">\n    <inertial><origin xyz=")[^"]+')
_JOINT = re.compile(
    r'\n  <joint name="(?P<name>\w+)" type="revolute">'
    r'\n    <parent link="(?P<parent>\w+)"/><child link="\w+"/>'
    r'(?P<place><origin xyz="[^"]+"/><axis xyz="[^"]+"/>)(?:.*\n)+?  </joint>'
)
_ROTOR_MASS = 1e-6  # [kg]; the links include the rotors' masses


def urdf(
    armature: np.ndarray | None = None, com_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> str:
    """URDF of the robot.

    URDF has no reflected inertia. For positive ``armature`` the joint gets a second one,
    ``<leg>_<joint>_rotor``, on the same parent and axis, whose link is the rotor: inertia
    armature/ratio², to be geared ratio:1 to the joint. Its kinetic energy is ½·armature·(joint_vel
    + ω/ratio)², with the parent's rotation ω; for a high ratio that is MuJoCo's
    ½·armature·joint_vel². ``armature`` is (12,) [kg·m²]; ``com_shift`` is added to the chassis'
    centre of mass [m].
    """
    text = _FILE.read_text()
    com = [float(value) for value in _CHASSIS_COM.findall(text)[0].split()]
    shifted = " ".join(f"{value + shift:.9g}" for value, shift in zip(com, com_shift, strict=True))
    text = _CHASSIS_COM.sub(shifted, text)
    if armature is None:
        return text
    reflected = iter(armature.tolist())
    return _JOINT.sub(lambda joint: joint[0] + _rotor(joint, next(reflected)), text)


def _rotor(joint: re.Match[str], armature: float) -> str:
    """A rotor on the joint's parent link, about its axis; PyBullet gears it to the joint."""
    if armature <= 0.0:
        return ""
    name = f"{joint['name']}_rotor"
    inertia = f"{armature / ROTOR_GEAR_RATIO**2:.9g}"
    return f"""
  <link name="{name}">
    <inertial><origin xyz="0 0 0"/><mass value="{_ROTOR_MASS:.9g}"/>
      <inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial>
    
  </link>
  <joint name="{name}" type="continuous">
    <parent link="{joint["parent"]}"/><child link="{name}"/>{joint["place"]}
  </joint>"""
