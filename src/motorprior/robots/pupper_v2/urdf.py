"""The Pupper as URDF text for PyBullet, from pupper_v2.urdf.

That file has the masses and limits of pupper_v2.xml. Load the text in PyBullet with
URDF_USE_INERTIA_FROM_FILE, or inertias are recomputed from the shapes.
"""

import re
from pathlib import Path

import numpy as np

from motorprior.robots.urdf_rotor import rotor_element

_FILE = Path(__file__).with_name("pupper_v2.urdf")
# the first link
_CHASSIS_COM = re.compile(r'(?<=<link name="chassis">\n    <inertial><origin xyz=")[^"]+')
_JOINT = re.compile(
    r'\n  <joint name="(?P<name>\w+)" type="revolute">'
    r'\n    <parent link="(?P<parent>\w+)"/><child link="\w+"/>'
    r'(?P<place><origin xyz="[^"]+"/><axis xyz="[^"]+"/>)(?:.*\n)+?  </joint>'
)


def urdf(
    armature: np.ndarray | None = None, com_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> str:
    """URDF of the robot.

    ``armature`` (12,) are reflected inertias of rotors, see `rotor_element` [kg·m²]; ``com_shift``
    is added to the chassis' centre of mass [m].
    """
    text = _FILE.read_text()
    com = [float(value) for value in _CHASSIS_COM.findall(text)[0].split()]
    shifted = " ".join(f"{value + shift:.9g}" for value, shift in zip(com, com_shift, strict=True))
    text = _CHASSIS_COM.sub(shifted, text)
    if armature is None:
        return text
    reflected = iter(armature.tolist())

    def with_rotor(joint: re.Match[str]) -> str:
        rotor = rotor_element(joint["name"], joint["parent"], joint["place"], next(reflected))
        return joint[0] + rotor

    return _JOINT.sub(with_rotor, text)
