"""Stanford Pupper v2.1: constants of the robot with their source. Masses and inertias are in pupper_v2.xml and .urdf.

Frame: x forward, y left, z up; SI units. Lengths, masses and inertias are from puppersim/data/pupper_v2a.urdf
(jietan/puppersim, Apache-2.0), whose robot faces -y: here (x, y, z) = (-y, x, z) of that file, and its left-right
differences (1.5 mm) are averaged. The chassis' box is an assumption, for pictures and contacts of a fallen robot.
"""

from __future__ import annotations

import numpy as np

ROBOT_NAME = "pupper_v2"
LEGS = ("FR", "FL", "RR", "RL")
JOINT_NAMES = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("abduction", "hip", "knee"))
NUM_JOINTS = len(JOINT_NAMES)

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
ENCODER_COUNTS = 8192 * 36  # per turn of the output: 8192 per turn of the rotor, gear 36:1 (DJI M2006 with C610)
# Robot's own angle = sign × angle here: the abduction axes of FR and RR are reversed (puppersim deployment). Assumed:
# abduction angles here have the signs of puppersim's simulation; docs/hardware.md describes how to check them.
JOINT_SIGNS = np.tile([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2)

FOOT_FRICTION = 0.45  # of the rubber foot [-]; push-up logs of the real robot identify 0.23-0.45
FOOT_RADIUS = 0.0095
THIGH_LENGTH, SHANK_LENGTH = 0.080, 0.110
HIP_X, HIP_Y = (0.075, -0.125), 0.0805  # hip axes of the front and rear legs, and feet of straight legs, in the chassis
MASS = 0.991 + 4 * (0.106 + 0.142 + 0.0381)  # chassis; abduction link, thigh, and shank with the foot of 0.1 g
