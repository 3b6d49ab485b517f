"""Constants of a robot's protocol, and the safety limits of its host."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of the host's safety gate and fault detection."""

    # Maximum position targets, currents and gains
    target_speed: float = 60.0  # [rad/s]; gaits reach 40 at the start of a swing; the motors' no-load speed is 52
    slow_speed: float = 1.5  # [rad/s] while ramping and crouching
    max_current: float = 7.0  # [A] per motor; 2022 deployment
    max_kp: float = 60.0  # [A/rad]; above the gains of every known deployment
    max_kd: float = 6.0  # [A·s/rad]
    # Falls: |roll| or |pitch| beyond max_tilt [rad] for tilt_time [s]; an IMU that repeats its reading for imu_time [s]
    max_tilt: float = 0.7  # training episodes end at 0.4, walking stays below 0.15
    tilt_time: float = 0.03  # one damaged frame is not a fall
    imu_time: float = 0.3  # a working sensor has noise
    # Error of a joint against its target with a first-order lag of kd/kp [rad], for tracking_time [s]
    tracking_error: float = 0.6  # five policies on twelve twins exceeded 0.45 for at most 0.2 s
    tracking_time: float = 0.25
    # Blocked, or a frozen encoder: moves less than stuck_motion while its lagged target moves by stuck_target [rad]
    stuck_motion: float = 0.004
    stuck_target: float = 0.2  # on these twins, targets led a static joint by at most 0.09 rad
    stuck_time: float = 0.25  # [s]
    # Telemetry
    telemetry_age: float = 0.1  # maximum age of a measurement in use [s]
    implausible_frames: int = 3  # so many in a row are a fault
    joint_speed: float = 20.0  # maximum plausible [rad/s]; walking stays below 13
    body_rate: float = 35.0  # maximum plausible [rad/s]; range of the gyroscope, 2000 °/s
    measured_current: float = 9.0  # [A], if reported, of any motor for current_time [s]; the firmware stops at 10
    current_time: float = 0.02  # one damaged frame is not an overcurrent
    # Late control steps; the motors hold the last target meanwhile
    tick_delay: float = 0.1  # of one step [s]; walks of a policy of 150 iterations stayed upright with twice this pause
    late_ticks: int = 10  # steps of the last hundred that are late by more than half a period
    stalled_time: float = 0.2  # their total lateness [s]; with 20 ms every tenth step no walk fell, with 50 ms 3 of 24
    watchdog: float = 0.13  # the host is silent [s]: idle; a control period, tick_delay, and 20 ms for the host to send


@dataclass(frozen=True, eq=False)
class Wire:
    """Constants of a servo bus: current = clip(kp·(target - angle) - kd·velocity, ±max_current) on the robot."""

    kp: float  # default gain [A/rad]
    kd: float  # default gain [A·s/rad]; it acts on the velocity, so a joint follows its target with a lag of kd/kp
    max_current: float  # [A] per motor
    torque_constant: float  # [N·m/A] at the joint
    joint_signs: np.ndarray  # (joints,) robot's own angle = sign × angle of the model
    encoder_counts: int  # per turn of the joint
    crouch_pose: np.ndarray  # (joints,) angles in which the current can be switched off softly [rad]
    folded_pose: np.ndarray  # (joints,) angles on its belly, switched off [rad]
    safety: SafetyLimits


@dataclass(frozen=True)
class MotorCommand:
    """Input of the current control: i = kp·(target - q) - kd·dq, within ±max_current."""

    target: np.ndarray  # (joints,) [rad]
    kp: np.ndarray  # (joints,) [A/rad]; 0 for a motor that is off
    kd: np.ndarray  # (joints,) [A·s/rad]
    max_current: float  # [A]

    def current(self, joint_pos: np.ndarray, joint_vel: np.ndarray) -> np.ndarray:
        """(joints,) currents [A] at (joints,) angles [rad] and velocities [rad/s]."""
        wanted = self.kp * (self.target - joint_pos) - self.kd * joint_vel
        return np.clip(wanted, -self.max_current, self.max_current)


@dataclass(frozen=True)
class SensorReadings:
    """Sensor readings of a robot, joints in the robot's signs."""

    pos: np.ndarray  # (joints,) [rad]
    vel: np.ndarray  # (joints,) [rad/s]
    current: np.ndarray  # (joints,) [A]
    attitude: np.ndarray  # roll, pitch, yaw [rad]
    rates: np.ndarray  # about the body's axes [rad/s]
