"""Arrays of a robot for the compiled walking code, and the sizes of observation and action."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from motorprior.locomotion.gaits import phases_of
from motorprior.locomotion.leg_kinematics import lever_arms
from motorprior.robots.robot import Robot

MODULATION = 5
"""Number of the last entries of an action: frequency, intensity, height, swing/stance ratio, turn."""
TILT_READINGS = 5
"""Number of the first entries of an observation: roll, pitch, and the rates about x, y and z; the joints follow."""
YAW_RATE = 4
"""Place of the rate about z in an observation."""
FOLLOWED = 6
"""Number of the last entries of an observation: drift, heading error, commanded speed and yaw rate, cosine and sine of
the phase."""
BEYOND = 1.2
"""Fastest command of a training over a robot's fastest [-]: at the edge of what they were trained for policies fall."""
UPRIGHT = 5.0
"""Stiffness against pitch that a walking body needs, in weight times height [-]. The small robot has 14 by its motors
alone; one of 15 kg with gains of 30 N·m/rad has 2, falls, and walks with 5."""
LEAD = 0.9
"""Share of a PD's lag kd/kp that the targets of the gait lead by [-]. All of it would be right for a motor without
delay that reaches every torque; on the fleets of the small robot 0.8 to 1 walk alike."""


class Body(NamedTuple):
    """Arrays of a robot with n joints and L legs in one gait; see `robots.robot.Robot` for sources."""

    nominal_pose: np.ndarray
    """(n,) joint angles of the nominal pose [rad]"""
    lower: np.ndarray
    """(n,) lower joint limits [rad]"""
    upper: np.ndarray
    """(n,) upper joint limits [rad]"""
    lead: np.ndarray
    """(n,) time by which targets lead the gait [s], LEAD · kd/kp"""
    yielding: np.ndarray
    """(n,) angle by which a joint yields to a torque, 1/kp [rad/(N·m)]"""
    weight: float
    """[N]"""
    level: float
    """share of an observed tilt that the legs reach against [-], see `_level`"""
    legs: np.ndarray
    """(L, 3) int64: joints of abduction, hip and knee"""
    lengths: np.ndarray
    """(L, 2) thigh and shank [m]"""
    foot_radius: np.ndarray
    """(L,) [m]"""
    rest: np.ndarray
    """(L, 4) foot in the nominal pose: forward and left of the base's origin, then forward of and below the hip axis in
    the plane of the leg [m]"""
    phases: np.ndarray
    """(L,) phases of the legs in the cycle of the gait, in [0, 1)"""
    swing_stance_ratio: float
    """usual time in swing over time in stance [-]"""
    frequency: float
    """usual frequency [Hz]"""
    swing_height: float
    """lift of a foot in swing [m]"""
    slowest: float
    """lowest commanded speed [m/s], 0 or negative"""
    fastest: float
    """highest commanded speed [m/s]"""
    yaw_rate: float
    """highest commanded yaw rate [rad/s]"""
    residual: float
    """largest correction of a target [rad]"""
    lowest: float
    """height of a fallen base [m]"""
    highest: float
    """height of a base that has taken off [m]"""
    reference_torque: float
    """torque that the reward's penalty counts as 1 [N·m]"""


def body_of(robot: Robot, gait: str = "trot") -> Body:
    """The arrays of a legged robot in a gait.

    Raises:
        ConfigError: it cannot walk, or not in this gait.
    """
    size = robot.require_legs()
    phases, ratio = phases_of(robot, gait)
    return Body(
        nominal_pose=robot.nominal_pose,
        lower=robot.lower,
        upper=robot.upper,
        lead=np.array([LEAD * joint.kd / joint.kp for joint in robot.joints]),
        yielding=np.array([1.0 / joint.kp for joint in robot.joints]),
        weight=robot.weight,
        level=_level(robot),
        legs=np.array([leg.joints for leg in robot.legs], dtype=np.int64),
        lengths=np.array([(leg.thigh, leg.shank) for leg in robot.legs]),
        foot_radius=np.array([leg.foot_radius for leg in robot.legs]),
        rest=np.array([(*leg.rest, *leg.reach(robot.nominal_pose)) for leg in robot.legs]),
        phases=phases,
        swing_stance_ratio=ratio,
        frequency=size.frequency,
        swing_height=size.swing_height,
        slowest=size.forward[0],
        fastest=size.forward[1],
        yaw_rate=size.yaw_rate,
        residual=size.residual,
        lowest=robot.min_base_height,
        highest=robot.max_base_height,
        reference_torque=robot.reference_torque,
    )


def _level(robot: Robot) -> float:
    """How much a robot needs its legs to level it: UPRIGHT m·g·h over its stiffness against pitch, less 1, at least 0.

    Two of its legs carry it, each of stiffness k = 1 / Σ arm² / kp at the foot, with the `lever_arms` of hip and knee,
    at the distance x of the feet fore and aft: 2 k x². Tilt makes the weight pull with m·g·h.
    """
    stiffness = 0.0
    for leg in robot.legs:
        hip, knee = leg.joints[1], leg.joints[2]
        by_hip, by_knee = lever_arms(leg.thigh, leg.shank, robot.nominal[hip], robot.nominal[knee])
        yielding = by_hip**2 / robot.joints[hip].kp + by_knee**2 / robot.joints[knee].kp
        stiffness += 2.0 * leg.rest[0] ** 2 / max(yielding, 1e-9) / len(robot.legs)
    return float(max(0.0, UPRIGHT * robot.weight * robot.standing_height / max(stiffness, 1e-9) - 1.0))


def readings(num_joints: int) -> int:
    """Observed quantities that a sensor reads: attitude, rates, joint angles."""
    return TILT_READINGS + num_joints


def observation_size(num_joints: int) -> int:
    """Length of an observation: what sensors read, then what the gait follows."""
    return readings(num_joints) + FOLLOWED


def action_size(num_joints: int) -> int:
    """Length of an action: one residual per joint, then the modulation of the gait."""
    return num_joints + MODULATION
