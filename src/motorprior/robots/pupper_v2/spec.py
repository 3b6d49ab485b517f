"""Stanford Pupper v2.1: every constant of the robot with its source. MJCF and URDF are generated from it.

Frame: x forward, y left, z up; SI units. Lengths, masses and inertias are from puppersim/data/pupper_v2a.urdf
(jietan/puppersim, Apache-2.0), whose robot faces -y: here (x, y, z) = (-y, x, z) of that file, and its left-right
differences (1.5 mm) are averaged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROBOT_NAME = "pupper_v2"
LEGS = ("FR", "FL", "RR", "RL")
JOINTS_PER_LEG = ("abduction", "hip", "knee")
JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in JOINTS_PER_LEG)
NUM_JOINTS = len(JOINT_NAMES)
SIDE = {"FR": -1.0, "FL": 1.0, "RR": -1.0, "RL": 1.0}

JOINT_LOWER = np.tile([-0.785, -1.309, -2.880], 4)  # [rad] (puppersim URDF)
JOINT_UPPER = np.tile([0.785, 4.451, 2.880], 4)
NOMINAL_POSE = np.tile([0.0, 0.6, -1.2], 4)  # standing [rad] (puppersim)
CROUCH_POSE = np.tile([0.0, 1.3, -2.2], 4)  # body at 9 cm, feet below the hips: the current can be switched off softly
FOLDED_POSE = np.tile([0.0, 1.6, -2.5], 4)  # switched off, on its belly

CONTROL_DT = 0.01  # policy period [s] (puppersim: 100 Hz)
PHYSICS_DT = 0.002  # MuJoCo step in training [s]
TWIN_PHYSICS_DT = 0.001  # MuJoCo step of the twin [s]: rate of the firmware's current loop (Nate711/DJIPupperTests)

WIRE_KP, WIRE_KD = 50.0, 5.0  # [A/rad], [A·s/rad] (2022 deployment); also in the logs that the fleets are fitted to
MAX_CURRENT = 7.0  # [A] (2022 deployment)
TORQUE_CONSTANT = 0.18  # at the output [N·m/A]
TORQUE_LIMIT = MAX_CURRENT * TORQUE_CONSTANT
ENCODER = "rotor"
ENCODER_COUNTS = 8192 * 36  # per turn of the output: 8192 per turn of the rotor, gear 36:1 (DJI M2006 with C610)
# Robot's own angle = sign × angle here: the abduction axes of FR and RR are reversed (puppersim deployment). Assumed:
# abduction angles here have the signs of puppersim's simulation; docs/hardware.md describes how to check them.
JOINT_SIGNS = np.tile([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2)

FOOT_FRICTION = 0.45  # of the rubber foot [-]; push-up logs of the real robot identify 0.23-0.45
FOOT_RADIUS = 0.0095
THIGH_LENGTH = 0.080
SHANK_LENGTH = 0.110
ABDUCTION_Y = 0.047
HIP_OFFSET = (-0.02725, 0.0395, 0.0)  # hip axis in the abduction frame, y outwards
KNEE_OFFSET = (0.0, -0.004, -THIGH_LENGTH)
FOOT_OFFSET = (0.0, -0.002, -SHANK_LENGTH)


@dataclass(frozen=True)
class Link:
    """A rigid body: mass [kg], centre of mass in its own frame [m] (y outwards), diagonal inertia [kg·m²]."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]


CHASSIS = Link(0.991, (0.048, 0.0, -0.00964), (1.75e-3, 6.26e-3, 6.78e-3))
ABDUCTION_LINK = Link(0.106, (-0.02615, 0.0139, 0.0), (6e-5, 2e-5, 6e-5))
THIGH = Link(0.142, (0.0, 0.0172, -0.061), (1.6e-4, 1.4e-4, 3e-5))
SHANK = Link(0.0381, (-0.00075, -0.0057, -0.0658), (1.8e-4, 1.8e-4, 2e-5))  # with the foot of 0.1 g
MASS = CHASSIS.mass + len(LEGS) * (ABDUCTION_LINK.mass + THIGH.mass + SHANK.mass)
CHASSIS_BOX_CENTER = (0.0, 0.0, 0.0)
CHASSIS_BOX_SIZE = (0.26, 0.11, 0.07)  # assumption, for pictures and contacts of a fallen robot


def mirrored(vector: tuple[float, float, float], leg: str) -> tuple[float, float, float]:
    """A vector of a leg given with y outwards, in the chassis' axes (y left)."""
    return (vector[0], SIDE[leg] * vector[1], vector[2])


def abduction_origin(leg: str) -> tuple[float, float, float]:
    """Origin of the abduction axis in the chassis frame [m]."""
    return (0.10225 if leg.startswith("F") else -0.09775, SIDE[leg] * ABDUCTION_Y, 0.0)
