"""The walking task: observation, reward, and the end of an episode.

Observation, clipped displacement and limits: jietan/puppersim (Apache-2.0). The reward for staying up, the
lighter torque penalty and the penalties for not going straight are ours: without the first two a fall pays.
"""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass

import numpy as np

from motorprior.bounds import require_number
from motorprior.compiled import njit
from motorprior.locomotion.body import PHASE_READINGS, TILT_READINGS
from motorprior.rotations import roll_pitch_yaw

MAX_TILT = 0.4  # [rad] of roll or pitch


@dataclass(frozen=True)
class TaskWeights:
    """Coefficients of the reward, all of which counts as metres walked.

    Attributes:
        max_speed: forward speed beyond which nothing more is earned, and backward speed beyond which nothing
            more is lost [m/s].
        alive: for each control step upright [m].
        torque: against Σ (torque/reference_torque)² over the joints, for each control step [m].
        lateral: against |sideways speed| [m/s per m/s].
        yaw_rate: against |yaw rate| [m/s per rad/s].
        heading: against |yaw| away from the initial heading [m/s per rad].

    Raises:
        ConfigError: a coefficient that is negative, not finite or no number.
    """

    max_speed: float = 0.5
    alive: float = 0.004
    torque: float = 0.3e-4
    lateral: float = 0.1
    yaw_rate: float = 0.02
    heading: float = 0.4

    def __post_init__(self) -> None:
        """Refuse coefficients that are negative, not finite or no numbers."""
        for name, value in asdict(self).items():
            require_number(f"task.{name}", value)

    def array(self) -> np.ndarray:
        """Shape (6,), in the order of the attributes, for `reward`."""
        return np.array(astuple(self), dtype=np.float64)


@njit(cache=True)
def observe(
    base_quat: np.ndarray,
    base_ang_vel_local: np.ndarray,
    measured_joint_pos: np.ndarray,
    phase: float,
    nominal_pose: np.ndarray,
    out: np.ndarray,
) -> None:
    """Observation: roll, pitch, their rates, joint angles, (cos 2πφ + 1)/2, (sin 2πφ + 1)/2.

    The rates are the body's own about x and y, as a gyroscope reads them, not derivatives of Euler angles.

    Args:
        base_quat: shape (4,), (w, x, y, z), base to world.
        base_ang_vel_local: shape (3,) [rad/s], in the body frame.
        measured_joint_pos: shape (joints,) [rad], as the encoders measure it.
        phase: gait phase φ in [0, 1).
        nominal_pose: shape (joints,) [rad].
        out: shape (joints + 6,) [rad, rad/s, rad relative to the nominal pose, 0..1], overwritten.
    """
    roll, pitch, _ = roll_pitch_yaw(base_quat)
    out[0] = roll
    out[1] = pitch
    out[2] = base_ang_vel_local[0]
    out[3] = base_ang_vel_local[1]
    for joint in range(nominal_pose.shape[0]):
        out[TILT_READINGS + joint] = measured_joint_pos[joint] - nominal_pose[joint]
    first = out.shape[0] - PHASE_READINGS
    out[first] = 0.5 * (math.cos(2.0 * math.pi * phase) + 1.0)
    out[first + 1] = 0.5 * (math.sin(2.0 * math.pi * phase) + 1.0)


@njit(cache=True)
def reward(
    forward_delta: float,
    lateral_velocity: float,
    yaw_rate: float,
    yaw: float,
    sum_torque_squared: float,
    alive: bool,
    control_dt: float,
    weights: np.ndarray,
) -> float:
    """Reward of one control step [m].

    r = clip(Δx, ±max_speed·dt) + alive - torque·Στ² - dt (lateral·|v_y| + yaw_rate·|ω_z| + heading·|ψ|).

    Args:
        forward_delta: Δx, displacement along world x, the initial heading [m].
        lateral_velocity: v_y, along world y [m/s].
        yaw_rate: ω_z [rad/s].
        yaw: ψ, away from the initial heading [rad].
        sum_torque_squared: Στ², torques over the reference torque, mean over the physics steps of this control step.
        alive: false in the step in which the robot falls.
        control_dt: dt, control period [s].
        weights: shape (6,), `TaskWeights.array()`.
    """
    furthest = weights[0] * control_dt
    earned = min(furthest, max(-furthest, forward_delta)) - weights[2] * sum_torque_squared
    if alive:
        earned += weights[1]
    crooked = weights[3] * abs(lateral_velocity) + weights[4] * abs(yaw_rate) + weights[5] * abs(yaw)
    return earned - control_dt * crooked


@njit(cache=True)
def fallen(roll: float, pitch: float, height: float, lowest: float, highest: float) -> bool:
    """Whether the episode ends: |roll| or |pitch| > 0.4 rad, height [m] not in [lowest, highest], or any is NaN."""
    upright = abs(roll) <= MAX_TILT and abs(pitch) <= MAX_TILT
    return not (upright and lowest <= height <= highest)
