"""Arrays of a robot for the compiled walking code, and the sizes of observation, action and policy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from motorprior.robots.robot import Robot

MODULATION = 4
"""Number of the last entries of an action: frequency, intensity, height and swing/stance ratio of the trot."""
TILT_READINGS = 4
"""Number of the first entries of an observation: roll, pitch and their rates; the joints follow, then the phase."""
PHASE_READINGS = 2


class Body(NamedTuple):
    """Arrays of a robot with n joints and L legs; see `robots.robot.Robot` for sources."""

    nominal_pose: np.ndarray
    """(n,) joint angles of the nominal pose [rad]"""
    lower: np.ndarray
    """(n,) lower joint limits [rad]"""
    upper: np.ndarray
    """(n,) upper joint limits [rad]"""
    legs: np.ndarray
    """(L, 3) int64: joints of abduction, hip and knee"""
    phases: np.ndarray
    """(L,) phases of the legs in the trot's cycle, in [0, 1)"""
    swing: float
    """amplitude of the hip at full intensity [rad]"""
    stance_extension: float
    """amplitude of the knee in stance [rad]"""
    lift_extension: float
    """amplitude of the knee in swing [rad]"""
    residual: float
    """largest correction of a target [rad]"""
    lowest: float
    """height of a fallen base [m]"""
    highest: float
    """height of a base that has taken off [m]"""
    reference_torque: float
    """torque that the reward's penalty counts as 1 [N·m]"""


def body_of(robot: Robot) -> Body:
    """The arrays of a legged robot.

    Raises:
        ConfigError: it cannot walk.
    """
    robot.require_legs()
    return Body(
        nominal_pose=robot.nominal_pose,
        lower=robot.lower,
        upper=robot.upper,
        legs=np.array([leg.joints for leg in robot.legs], dtype=np.int64),
        phases=np.array([leg.phase for leg in robot.legs]),
        swing=robot.gait.swing,
        stance_extension=robot.gait.stance_extension,
        lift_extension=robot.gait.lift_extension,
        residual=robot.gait.residual,
        lowest=robot.lowest,
        highest=robot.highest,
        reference_torque=robot.reference_torque,
    )


def readings(num_joints: int) -> int:
    """Observed quantities that a sensor reads: attitude, rates, joint angles."""
    return TILT_READINGS + num_joints


def observation_size(num_joints: int) -> int:
    """Length of an observation: what sensors read, then cosine and sine of the phase."""
    return readings(num_joints) + PHASE_READINGS


def action_size(num_joints: int) -> int:
    """Length of an action: one residual per joint, then the modulation of the trot."""
    return num_joints + MODULATION
