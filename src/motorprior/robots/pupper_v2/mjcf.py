"""The Pupper as MJCF text, generated from spec.py."""

from __future__ import annotations

from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.spec import Link


def _vector(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _inertial(link: Link, leg: str | None = None) -> str:
    com = link.com if leg is None else spec.mirrored(link.com, leg)
    return f'<inertial pos="{_vector(com)}" mass="{link.mass:.9g}" diaginertia="{_vector(link.inertia)}"/>'


def _joint(leg: str, joint: str, axis: str) -> str:
    index = spec.JOINT_NAMES.index(f"{leg}_{joint}")
    limits = (spec.JOINT_LOWER[index], spec.JOINT_UPPER[index])
    return f'<joint name="{leg}_{joint}" axis="{axis}" range="{_vector(limits)}"/>'


def _leg(leg: str) -> str:
    side = spec.SIDE[leg]
    thigh = f'fromto="0 0 0 {_vector(spec.mirrored(spec.KNEE_OFFSET, leg))}" size="0.012"'
    shank = f'fromto="0 0 0 {_vector(spec.mirrored(spec.FOOT_OFFSET, leg))}" size="0.006"'
    return f"""
      <body name="{leg}_abduction_link" pos="{_vector(spec.abduction_origin(leg))}">
        {_inertial(spec.ABDUCTION_LINK, leg)}{_joint(leg, "abduction", "1 0 0")}
        <geom type="cylinder" size="0.015 0.0375" pos="{_vector(spec.mirrored((-0.02725, 0.0235, 0), leg))}"
          euler="1.5707963 0 0" class="visual"/>
        <body name="{leg}_thigh" pos="{_vector(spec.mirrored(spec.HIP_OFFSET, leg))}">
          {_inertial(spec.THIGH, leg)}{_joint(leg, "hip", "0 1 0")}
          <geom type="capsule" {thigh} class="visual"/>
          <body name="{leg}_shank" pos="{_vector(spec.mirrored(spec.KNEE_OFFSET, leg))}">
            {_inertial(spec.SHANK, leg)}{_joint(leg, "knee", "0 1 0")}
            <geom type="capsule" {shank} class="visual"/>
            <geom name="{leg}_foot" type="sphere" size="{spec.FOOT_RADIUS}"
              pos="{_vector((spec.FOOT_OFFSET[0], side * spec.FOOT_OFFSET[1], spec.FOOT_OFFSET[2]))}" class="visual"/>
          </body>
        </body>
      </body>"""


def mjcf() -> str:
    """MJCF of the robot alone, in the air; `robots.build_model` adds floor, contacts and clock."""
    legs = "".join(_leg(leg) for leg in spec.LEGS)
    box = tuple(size / 2 for size in spec.CHASSIS_BOX_SIZE)
    return f"""<mujoco model="{spec.ROBOT_NAME}">
  <compiler angle="radian" autolimits="true"/>
  <default><default class="visual"><geom contype="0" conaffinity="0" rgba="0.85 0.65 0.2 1"/></default></default>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <body name="chassis">
      <freejoint name="base"/>{_inertial(spec.CHASSIS)}
      <geom type="box" size="{_vector(box)}" pos="{_vector(spec.CHASSIS_BOX_CENTER)}" class="visual"/>{legs}
    </body>
  </worldbody>
</mujoco>
"""
