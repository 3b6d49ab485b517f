"""Stanford Pupper v2.1: every constant of the robot, once, with its source. MJCF and URDF are generated from it.

Frame: x forward, y left, z up; SI units. Lengths, masses and inertias are facts read from
puppersim/data/pupper_v2a.urdf (jietan/puppersim, Apache-2.0), whose robot faces -y: here
(x, y, z) = (-y, x, z) of that file, and its small left-right differences (1.5 mm) are averaged.
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
FRONT = {"FR": True, "FL": True, "RR": False, "RL": False}

NOMINAL_POSE = np.tile([0.0, 0.6, -1.2], 4)
"""Joint angles of the standing pose [rad] (puppersim)."""

JOINT_LOWER = np.tile([-0.785, -1.309, -2.880], 4)
JOINT_UPPER = np.tile([0.785, 4.451, 2.880], 4)
"""Joint limits [rad] (puppersim URDF)."""

CONTROL_DT = 0.01
"""Policy period [s] (puppersim: 100 Hz)."""
PHYSICS_DT = 0.002
"""MuJoCo step [s] of the training simulation."""
TWIN_PHYSICS_DT = 0.001
"""MuJoCo step [s] of the twin: the rate of the firmware's current loop (Nate711/DJIPupperTests)."""

MAX_CURRENT = 7.0
TORQUE_CONSTANT = 0.18
TORQUE_LIMIT = MAX_CURRENT * TORQUE_CONSTANT
"""Current limit [A] on the robot (2022 deployment), torque constant [N·m/A] at the output, and their product."""

ENCODER = "rotor"
"""Where joint angles and velocities are measured: 8192 counts per turn of the rotor (DJI M2006 with C610)."""

FOOT_FRICTION = 0.45
"""Sliding friction of the rubber foot [-]; push-up logs of the real robot identify 0.23-0.45."""
FOOT_RADIUS = 0.0095
THIGH_LENGTH = 0.080
SHANK_LENGTH = 0.110

ABDUCTION_X = {True: 0.10225, False: -0.09775}
"""x of the abduction axis' origin in the chassis frame [m], front and rear."""
ABDUCTION_Y = 0.047
HIP_OFFSET = (-0.02725, 0.0395, 0.0)
"""Hip axis in the abduction frame [m], y outwards."""
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
SHANK = Link(0.0381, (-0.00075, -0.0057, -0.0658), (1.8e-4, 1.8e-4, 2e-5))
"""The shank with the 0.1 g foot."""
MASS = CHASSIS.mass + len(LEGS) * (ABDUCTION_LINK.mass + THIGH.mass + SHANK.mass)
"""Of the whole robot [kg]."""

CHASSIS_BOX_CENTER = (0.0, 0.0, 0.0)
CHASSIS_BOX_SIZE = (0.26, 0.11, 0.07)
"""Box about the body [m]; assumption, for pictures and for contacts of a fallen robot."""


def mirrored(vector: tuple[float, float, float], leg: str) -> tuple[float, float, float]:
    """A vector of a leg given with y outwards, in the chassis' axes (y left)."""
    return (vector[0], SIDE[leg] * vector[1], vector[2])


def abduction_origin(leg: str) -> tuple[float, float, float]:
    """Origin of the abduction axis in the chassis frame [m]."""
    return (ABDUCTION_X[FRONT[leg]], SIDE[leg] * ABDUCTION_Y, 0.0)


JOINT_SIGNS = np.tile([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2)
"""Robot's own angle = sign × angle here: the abduction axes of FR and RR point the other way (puppersim deployment).

Assumption: the abduction angles of this frame have the signs of puppersim's simulation. docs/hardware.md has the
check by hand that every owner makes once."""

WIRE_KP = 50.0
WIRE_KD = 5.0
"""Gains on the robot [A/rad], [A·s/rad] (2022 deployment): those that the logs behind the fleets were recorded with."""
CROUCH_POSE = np.tile([0.0, 1.3, -2.2], 4)
"""Joint angles [rad] with the body 9 cm over the ground, feet below the hips: losing current is soft from here."""
FOLDED_POSE = np.tile([0.0, 1.6, -2.5], 4)
"""How it lies before it is switched on [rad]: on its belly, legs folded."""
ENCODER_COUNTS = 8192 * 36
"""Of the encoder per turn of the output: 8192 per turn of the rotor, gear 36:1 (DJI M2006)."""
