"""The Pupper as MJCF text for MuJoCo, generated from spec.py."""

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


CONTACT_TIME, CONTACT_DT = 0.02, 0.001
"""Time constant of a foot's contact, MuJoCo's default, and longest step at which it is damped critically [s]."""


def _foot_pair(leg: str, friction: float, physics_dt: float) -> str:
    sliding = f"{friction:.9g} {friction:.9g} 0.005 0.0001 0.0001"
    damping = max(1.0, physics_dt / CONTACT_DT)
    contact = f"{CONTACT_TIME:.9g} {damping:.9g}"
    return f'<pair geom1="floor" geom2="{leg}_foot" condim="3" friction="{sliding}" solref="{contact}"/>'


def mjcf(*, physics_dt: float = spec.PHYSICS_DT, foot_friction: float = spec.FOOT_FRICTION, hung: bool = False) -> str:
    """MJCF of the robot on a flat floor.

    Four explicit foot-floor pairs are the only contacts: knees and chassis of a robot that goes down pass
    through the floor until the episode ends (tilt 0.4 rad, height 0.05 m). A longer step leaves more bounce in a
    contact: its damping ratio grows with the step, so that the same motors trot alike at 1 and 2 ms
    (``benchmarks/floors.py``). Constraint islands are off, the
    Jacobian dense and the integrator Euler with implicit joint damping, which is fastest for a robot of this
    size.

    Args:
        physics_dt: step [s].
        foot_friction: sliding friction of the feet [-].
        hung: weld the chassis to the world 0.4 m above the floor instead of leaving it free.
    """
    base = "" if hung else '<freejoint name="base"/>'
    height = 0.4 if hung else spec.standing_height()
    legs = "".join(_leg(leg) for leg in spec.LEGS)
    pairs = "".join(_foot_pair(leg, foot_friction, physics_dt) for leg in spec.LEGS)
    box = tuple(size / 2 for size in spec.CHASSIS_BOX_SIZE)
    return f"""<mujoco model="{spec.ROBOT_NAME}">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{physics_dt:.9g}" gravity="0 0 -{spec.GRAVITY}" integrator="Euler" jacobian="dense">
    <flag island="disable"/>
  </option>
  <default><default class="visual"><geom contype="0" conaffinity="0" rgba="0.85 0.65 0.2 1"/></default></default>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <geom name="floor" type="plane" size="0 0 0.05" contype="0" conaffinity="0" rgba="0.9 0.9 0.9 1"/>
    <body name="chassis" pos="0 0 {height:.9g}">
      {base}{_inertial(spec.CHASSIS)}
      <geom type="box" size="{_vector(box)}" pos="{_vector(spec.CHASSIS_BOX_CENTER)}" class="visual"/>{legs}
    </body>
  </worldbody>
  <contact>{pairs}</contact>
</mujoco>
"""
