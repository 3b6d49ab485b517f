"""Stanford Pupper v2.1 as a `Robot`, with the sources of its constants.

pupper_v2.xml and .urdf have the masses. Frame: x forward, y left, z up; SI units. Lengths, masses
and inertias are from puppersim/data/pupper_v2a.urdf (jietan/puppersim, Apache-2.0), whose robot
faces -y: here (x, y, z) = (-y, x, z) of that file, and its left-right differences (1.5 mm) are
averaged. The chassis' box is an assumption, for pictures and contacts of a fallen robot.
"""

from pathlib import Path

import numpy as np

from motorprior.robots.model_source import ModelFile
from motorprior.robots.pupper_v2.urdf import urdf
from motorprior.robots.robot import GRAVITY, Gait, Joint, Leg, Robot, SafetyLimits, Wire

_FOLDER = Path(__file__).parent
_FLEETS = ("pupper_v2", "mixed", "foreign_direct", "foreign_servo")
_LEGS = ("FR", "FL", "RR", "RL")
_PHASES = (0.0, 0.5, 0.5, 0.0)
# [rad] (puppersim URDF)
_LIMITS = {"abduction": (-0.785, 0.785), "hip": (-1.309, 4.451), "knee": (-2.880, 2.880)}
# standing [rad] (puppersim)
_HIP = 0.6
_KNEE = -1.2
_THIGH_LENGTH = 0.080
_SHANK_LENGTH = 0.110
# hip axes of front and rear legs, and feet of straight legs, in the chassis
_HIP_X = (0.075, -0.125)
_HIP_Y = 0.0805
# chassis; abduction link, thigh, and shank with the foot of 0.1 g
_MASS = 0.991 + 4 * (0.106 + 0.142 + 0.0381)
_WIRE = Wire(
    kp=50.0,  # (2022 deployment); also in the logs that the fleets are fitted to
    kd=5.0,
    max_current=7.0,  # (2022 deployment)
    torque_constant=0.18,
    # The abduction axes of FR and RR are reversed (puppersim deployment). Assumed: abduction angles
    # of the model have the signs of puppersim's simulation; docs/hardware.md describes how to check
    # them.
    joint_signs=np.tile([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2),
    encoder_counts=8192 * 36,  # 8192 per turn of the rotor, gear 36:1 (DJI M2006 with C610)
    crouch_pose=np.tile([0.0, 1.3, -2.2], 4),  # body at 9 cm, feet below the hips
    folded_pose=np.tile([0.0, 1.6, -2.5], 4),
    safety=SafetyLimits(),
)
# kp [N·m/rad], kd [N·m·s/rad] and torque limit [N·m] of each joint
_GAINS = (
    _WIRE.kp * _WIRE.torque_constant,
    _WIRE.kd * _WIRE.torque_constant,
    _WIRE.max_current * _WIRE.torque_constant,
)


def _leg(index: int) -> Leg:
    forward = (
        _HIP_X[index // 2] - _THIGH_LENGTH * np.sin(_HIP) - _SHANK_LENGTH * np.sin(_HIP + _KNEE)
    )
    return Leg(
        name=_LEGS[index],
        joints=(3 * index, 3 * index + 1, 3 * index + 2),
        foot=f"{_LEGS[index]}_foot",
        phase=_PHASES[index],
        thigh=_THIGH_LENGTH,
        shank=_SHANK_LENGTH,
        foot_radius=0.0095,
        rest=(round(float(forward), 9), _HIP_Y if index % 2 else -_HIP_Y),
    )


def _joints() -> tuple[Joint, ...]:
    joints = []
    for leg in _LEGS:
        for part, limits in _LIMITS.items():
            joints.append(Joint(f"{leg}_{part}", *limits, *_GAINS))
    return tuple(joints)


_NOMINAL = (0.0, _HIP, _KNEE) * 4
_MADE_LEGS = tuple(map(_leg, range(4)))
PUPPER_V2 = Robot(
    name="pupper_v2",
    motor="DJI M2006 P36 + C610",
    joints=_joints(),
    base="free",
    model=ModelFile.of(_FOLDER / "pupper_v2.xml", urdf),
    num_links=13,
    nominal=_NOMINAL,
    encoder="rotor",
    legs=_MADE_LEGS,
    gait=Gait(frequency=2.1, swing_height=0.03, forward=(-0.2, 0.5)),
    weight=round(GRAVITY * _MASS, 9),
    standing_height=round(_MADE_LEGS[0].hip_height(np.array(_NOMINAL)), 9),
    min_base_height=0.05,
    max_base_height=0.6,
    suspended_height=0.4,
    reference_torque=1.0,
    foot_friction=0.45,  # push-up logs of the real robot identify 0.23-0.45
    given_classes=("M2006",) * 12,  # the same motor everywhere
    fleets=tuple((name, str(_FOLDER / "fleets" / f"{name}.toml")) for name in _FLEETS),
    physics_dt=0.002,
    control_dt=0.01,  # (puppersim: 100 Hz)
    twin_physics_dt=0.001,  # rate of the firmware's current loop (Nate711/DJIPupperTests)
    wire=_WIRE,
)
