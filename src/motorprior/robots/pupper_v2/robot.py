"""Stanford Pupper v2.1 as a `Robot`, from the constants of spec.py and the models next to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.robots.model_source import GeneratedModel
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.urdf import urdf
from motorprior.robots.robot import GRAVITY, Gait, Joint, Leg, Robot
from motorprior.robots.wire import SafetyLimits, Wire

_FOLDER = Path(__file__).parent
_FLEETS = ("pupper_v2", "mixed", "foreign_direct", "foreign_servo")
_PHASES = (0.0, 0.5, 0.5, 0.0)


def _joint(index: int) -> Joint:
    return Joint(
        name=spec.JOINT_NAMES[index],
        lower=float(spec.JOINT_LOWER[index]),
        upper=float(spec.JOINT_UPPER[index]),
        kp=spec.WIRE_KP * spec.TORQUE_CONSTANT,
        kd=spec.WIRE_KD * spec.TORQUE_CONSTANT,
        torque_limit=spec.MAX_CURRENT * spec.TORQUE_CONSTANT,
        encoder="rotor",
    )


def _leg(index: int) -> Leg:
    _, hip, knee = spec.NOMINAL_POSE[:3]
    forward = spec.HIP_X[index // 2] - spec.THIGH_LENGTH * np.sin(hip) - spec.SHANK_LENGTH * np.sin(hip + knee)
    return Leg(
        name=spec.LEGS[index],
        joints=(3 * index, 3 * index + 1, 3 * index + 2),
        foot=f"{spec.LEGS[index]}_foot",
        phase=_PHASES[index],
        thigh=spec.THIGH_LENGTH,
        shank=spec.SHANK_LENGTH,
        foot_radius=spec.FOOT_RADIUS,
        rest=(round(float(forward), 9), spec.HIP_Y if index % 2 else -spec.HIP_Y),
    )


_LEGS = tuple(_leg(index) for index in range(len(spec.LEGS)))
PUPPER_V2 = Robot(
    name=spec.ROBOT_NAME,
    motor="DJI M2006 P36 + C610",
    joints=tuple(_joint(index) for index in range(spec.NUM_JOINTS)),
    base="free",
    model=GeneratedModel((_FOLDER / "pupper_v2.xml").read_text, urdf),
    num_links=1 + spec.NUM_JOINTS,
    nominal=tuple(spec.NOMINAL_POSE.tolist()),
    legs=_LEGS,
    gait=Gait(frequency=2.1, swing_height=0.03, forward=(-0.2, 0.5)),
    weight=round(GRAVITY * spec.MASS, 9),
    standing_height=round(_LEGS[0].hip_height(spec.NOMINAL_POSE), 9),
    min_base_height=0.05,
    max_base_height=0.6,
    suspended_height=0.4,
    reference_torque=1.0,
    foot_friction=spec.FOOT_FRICTION,
    stated_classes=("M2006",) * spec.NUM_JOINTS,  # the same motor everywhere
    fleets=tuple((name, str(_FOLDER / "fleets" / f"{name}.toml")) for name in _FLEETS),
    physics_dt=spec.PHYSICS_DT,
    control_dt=spec.CONTROL_DT,
    twin_physics_dt=spec.TWIN_PHYSICS_DT,
    wire=Wire(
        kp=spec.WIRE_KP,
        kd=spec.WIRE_KD,
        max_current=spec.MAX_CURRENT,
        torque_constant=spec.TORQUE_CONSTANT,
        joint_signs=spec.JOINT_SIGNS,
        encoder_counts=spec.ENCODER_COUNTS,
        crouch_pose=spec.CROUCH_POSE,
        folded_pose=spec.FOLDED_POSE,
        safety=SafetyLimits(),
    ),
)
