"""Reflected inertia in a URDF: a rotor beside the joint, for PyBullet to gear to it."""

# Turns of a rotor body per turn of its joint. The real ratio of 36 would couple the rotor to the
# motion of its link, by armature/36, which MuJoCo's armature does not. The error of a lightly
# damped PD is 0.3 mrad with 1e3 and 0.02 mrad with 1e5; 1e6 is no better.
ROTOR_GEAR_RATIO = 1e5
_ROTOR_MASS = 1e-6  # [kg]; the links include the rotors' masses


def rotor_element(joint: str, parent: str, place: str, armature: float) -> str:
    """Link and joint ``<joint>_rotor`` on a joint's parent link, about its axis.

    ``place`` are the joint's elements origin and axis. The inertia is armature/ratio² [kg·m²]; the
    kinetic energy of the geared rotor is ½·armature·(joint_vel + ω/ratio)², with the parent's
    rotation ω; for a high ratio that is MuJoCo's ½·armature·joint_vel². Empty without armature.
    """
    if armature <= 0.0:
        return ""
    name = f"{joint}_rotor"
    inertia = f"{armature / ROTOR_GEAR_RATIO**2:.9g}"
    return f"""
  <link name="{name}">
    <inertial><origin xyz="0 0 0"/><mass value="{_ROTOR_MASS:.9g}"/>
      <inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial>

  </link>
  <joint name="{name}" type="continuous">
    <parent link="{parent}"/><child link="{name}"/>{place}
  </joint>"""
