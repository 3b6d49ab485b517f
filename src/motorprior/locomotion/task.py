"""The walking task: observation, reward, and the end of an episode.

A robot follows a command: a speed along its own heading and a yaw rate. Its observations are its own measurements:
attitude and rates of its IMU, its joints, the command, and the heading integrated from its gyroscope.
"""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass
from typing import NamedTuple

import numpy as np

from motorprior.backend import BackendState
from motorprior.bounds import require_number
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line
from motorprior.locomotion.body import NUM_IMU_READINGS, Body
from motorprior.rotations import roll_pitch_below, roll_pitch_yaw

MAX_TILT = 0.4  # [rad] of roll or pitch
SPEED_FILTER = 0.3  # [s] time constant of the filtered speed, about a step of a leg: speed varies within a step
CONTACT_HEIGHT = 0.002  # [m] a foot whose lowest point is lower is on the ground


@dataclass(frozen=True)
class TaskWeights:
    """Coefficients of the reward, which is in metres walked; ConfigError for one that is not a number of at least 0."""

    alive: float = 1.0  # per second upright [m/s]
    speed: float = 2.0  # of |filtered forward speed - commanded speed| [m/s per m/s]
    lateral: float = 1.0  # of |filtered sideways speed| [m/s per m/s]
    heading: float = 1.0  # of |heading error| [m/s per rad]
    yaw_rate: float = 0.02  # of |yaw rate - commanded yaw rate| [m/s per rad/s]
    tilt: float = 0.2  # of |roll| + |pitch| [m/s per rad]
    torque: float = 0.003  # of Σ (torque/reference_torque)² over the joints [m/s]
    slip: float = 0.5  # of Σ sliding speed over the feet on the ground [m/s per m/s]

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            require_number(f"task.{name}", value)

    def array(self) -> np.ndarray:
        """Shape (8,), in the order of the attributes, for `reward`."""
        return np.array(astuple(self), dtype=np.float64)


@njit(cache=True)
def write_readings(
    body: Body, roll: float, pitch: float, rates: np.ndarray, joint_pos: np.ndarray, observation: np.ndarray
) -> None:
    """Write the first 5 + joints of an observation: roll, pitch [rad], the three body rates [rad/s], joint angles.

    Joint angles are relative to the nominal pose [rad].
    """
    observation[0], observation[1] = roll, pitch
    for axis in range(3):
        observation[2 + axis] = rates[axis]
    for joint in range(body.nominal_pose.shape[0]):
        observation[NUM_IMU_READINGS + joint] = joint_pos[joint] - body.nominal_pose[joint]


@njit(cache=True)
def observe(body: Body, state: BackendState, observation: np.ndarray) -> None:
    """`write_readings` of a state."""
    roll, pitch, _ = roll_pitch_yaw(state.base_quat)
    write_readings(body, roll, pitch, state.base_ang_vel, state.measured_joint_pos, observation)


@njit(cache=True)
def heading_rate(observation: np.ndarray) -> float:
    """Rate of the heading [rad/s] from observed attitude and rates: (ω_y sin φ + ω_z cos φ) / cos θ."""
    roll, pitch = observation[0], observation[1]
    return (observation[3] * math.sin(roll) + observation[4] * math.cos(roll)) / math.cos(pitch)


@njit(cache=True)
def wrapped(angle: float) -> float:
    """The same angle in [-π, π) [rad]."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(cache=True)
def sliding(body: Body, feet: np.ndarray, state: BackendState, pitch: float, yaw: float) -> float:
    """Sum over the feet on the ground of their sliding speed [m/s]; stores their positions in ``feet``.

    Sliding is the displacement of the foot's centre less its rolling, radius times rotation of the shank. Feet of
    unknown position (NaN) count as 0. ``feet`` (legs, 4) are those of `control_step.GaitState` one control step ago,
    ``pitch`` and ``yaw`` of the body [rad].
    """
    total, cosine, sine, joint_pos = 0.0, math.cos(yaw), math.sin(yaw), state.measured_joint_pos
    for leg in range(body.legs.shape[0]):
        angle = pitch + joint_pos[body.legs[leg, 1]] + joint_pos[body.legs[leg, 2]]
        radius, before, foot = body.foot_radius[leg], feet[leg], state.foot_pos[leg]
        if foot[2] < radius + CONTACT_HEIGHT and before[2] < radius + CONTACT_HEIGHT:  # false for NaN
            rolled = radius * (angle - before[3])
            x, y = foot[0] - before[0] - rolled * cosine, foot[1] - before[1] - rolled * sine
            total += math.sqrt(x * x + y * y) / body.control_dt
        before[:3] = foot
        before[3] = angle
    return total


@njit(cache=True)
def reward(
    speed_error: float,
    lateral_speed: float,
    heading_error: float,
    yaw_rate_error: float,
    tilt: float,
    sum_torque_squared: float,
    slip: float,
    alive: bool,
    control_dt: float,
    weights: np.ndarray,
) -> float:
    """Reward of one control step [m]: dt (alive - Σ weight · |error|).

    Args:
        speed_error: filtered forward speed less the commanded one [m/s].
        lateral_speed: filtered speed to the left [m/s].
        heading_error: heading less the integral of the commanded yaw rate [rad].
        yaw_rate_error: yaw rate less the commanded one [rad/s].
        tilt: |roll| + |pitch| [rad].
        sum_torque_squared: Στ², torques over the reference torque, mean over the physics steps of this control step.
        slip: sum of the sliding speeds of the feet on the ground [m/s], see `sliding`.
        alive: false in the step in which the robot falls.
        control_dt: dt, control period [s].
        weights: shape (8,), `TaskWeights.array()`.
    """
    earned = weights[0] if alive else 0.0
    earned -= weights[1] * abs(speed_error) + weights[2] * abs(lateral_speed)
    earned -= weights[3] * abs(heading_error) + weights[4] * abs(yaw_rate_error)
    return control_dt * (earned - weights[5] * tilt - weights[6] * sum_torque_squared - weights[7] * slip)


@njit(cache=True)
def fallen(roll: float, pitch: float, height: float, lowest: float, highest: float) -> bool:
    """Whether the episode ends: |roll| or |pitch| > 0.4 rad, height [m] not in [lowest, highest], or any is NaN."""
    upright = abs(roll) <= MAX_TILT and abs(pitch) <= MAX_TILT
    return not (upright and lowest <= height <= highest)


class SensorErrors(NamedTuple):
    """Sensor errors of one episode, for compiled code."""

    noise: np.ndarray  # (observations, readings) added to each observation; no rows without noise
    ages: np.ndarray  # (observations,) age of the reading in each observation [control steps]
    past: np.ndarray  # (rows, readings) true readings, a delay line; no rows without delay; state
    up: np.ndarray  # (3,) unit vector against gravity, in the world; on a slope not the normal of the ground


def perfect_sensors() -> SensorErrors:
    """Neither noise nor delay, on level ground."""
    return SensorErrors(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.array([0.0, 0.0, 1.0]))


@njit(cache=True, nogil=True)
def apply_sensor_errors(sensors: SensorErrors, count: int, base_quat: np.ndarray, observation: np.ndarray) -> None:
    """Replace the true readings of an observation by the measured ones.

    Roll and pitch relative to the ground become those relative to gravity. A delay between two control steps
    interpolates linearly between their readings; readings before the reset are those of the reset. ``count`` is the
    number of observations since the reset before this one, ``base_quat`` (4,) rotation_base_to_world.
    """
    if sensors.up[2] < 1.0:
        observation[0], observation[1] = roll_pitch_below(sensors.up, base_quat)
    rows, readings = sensors.past.shape
    if rows > 0:
        if count == 0:
            fill_line(sensors.past, 0, observation[:readings])
        newest = write_line(sensors.past, 0, count, observation[:readings])
        for i in range(readings):
            observation[i] = interpolated(sensors.past, 0, newest, sensors.ages[count], i)
    if sensors.noise.shape[0] > 0:
        for i in range(sensors.noise.shape[1]):
            observation[i] += sensors.noise[count, i]
