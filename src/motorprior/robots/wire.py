"""Constants of a robot's protocol, and the safety limits of its host."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of the host's safety gate and fault detection.

    Attributes:
        target_speed: maximum rate of a position target [rad/s].
        slow_speed: the same while ramping and crouching [rad/s].
        max_current: per motor [A].
        max_kp: [A/rad].
        max_kd: [A·s/rad].
        max_tilt: |roll| or |pitch| of a falling robot [rad], for tilt_time.
        tilt_time: [s].
        imu_time: an IMU that repeats its reading for this time [s] is frozen.
        tracking_error: of a joint against its target with a first-order lag of kd/kp [rad], for tracking_time.
        tracking_time: [s].
        stuck_motion: a joint that moves less than this [rad] ...
        stuck_target: ... while its lagged target moves by this [rad] ...
        stuck_time: ... within this time [s] is blocked or has a frozen encoder.
        telemetry_age: maximum age of a measurement in use [s].
        implausible_frames: number of consecutive implausible frames that is a fault.
        joint_speed: maximum plausible joint speed [rad/s].
        body_rate: maximum plausible rotation of the body [rad/s].
        measured_current: maximum of any motor [A], if reported, for current_time.
        current_time: [s].
        temperature: maximum of any motor [°C], if reported.
        battery: minimum voltage [V], if reported.
        warning_time: of temperature or battery beyond their limits [s].
        tick_delay: maximum delay of one control step [s]; the motors hold the last target meanwhile.
        late_ticks: maximum number of steps of the last hundred that are late by more than half a period.
        stalled_time: maximum total lateness of the last hundred steps [s].
        watchdog: the watchdog process sends idle when the host is silent for this time [s].
    """

    target_speed: float = 60.0  # gaits reach 40 at the start of a swing; the motors' no-load speed is 52
    slow_speed: float = 1.5
    max_current: float = 7.0  # 2022 deployment
    max_kp: float = 60.0  # above the gains of every known deployment
    max_kd: float = 6.0
    max_tilt: float = 0.7  # training episodes end at 0.4, walking stays below 0.15
    tilt_time: float = 0.03  # one damaged frame is not a fall
    imu_time: float = 0.3  # a working sensor has noise
    tracking_error: float = 0.6  # five policies on twelve twins exceeded 0.45 for at most 0.2 s
    tracking_time: float = 0.25
    stuck_motion: float = 0.004
    stuck_target: float = 0.2  # on these twins, targets led a static joint by at most 0.09 rad
    stuck_time: float = 0.25
    telemetry_age: float = 0.1
    implausible_frames: int = 3
    joint_speed: float = 20.0  # walking stays below 13
    body_rate: float = 35.0  # range of the gyroscope, 2000 °/s
    measured_current: float = 9.0  # the firmware stops at 10
    current_time: float = 0.02  # one damaged frame is not an overcurrent
    temperature: float = 80.0  # assumption: the windings withstand about 100
    battery: float = 19.8  # assumption: 3.3 V for each of six cells
    warning_time: float = 0.3
    tick_delay: float = 0.1  # walks of a policy of 150 iterations stayed upright with twice this pause
    late_ticks: int = 10
    stalled_time: float = 0.2  # with pauses of 20 ms every tenth step no walk fell, with 50 ms 3 of 24 did
    watchdog: float = 0.13  # a control period, tick_delay, and 20 ms for the host to send


@dataclass(frozen=True)
class Wire:
    """Constants of a servo bus: current = clip(kp·(target - angle) - kd·velocity, ±max_current) on the robot.

    Attributes:
        kp: default gain [A/rad].
        kd: default gain [A·s/rad]; it acts on the velocity, so a joint follows its target with a lag of kd/kp.
        max_current: [A] per motor.
        torque_constant: [N·m/A] at the joint.
        signs: robot's own angle = sign × angle of the model, per joint.
        encoder_counts: per turn of the joint.
        crouch: joint angles in which the current can be switched off softly [rad].
        folded: joint angles on its belly, switched off [rad].
        safety: limits of the host.
    """

    kp: float
    kd: float
    max_current: float
    torque_constant: float
    signs: tuple[float, ...]
    encoder_counts: int
    crouch: tuple[float, ...]
    folded: tuple[float, ...]
    safety: SafetyLimits

    @property
    def tracking_lag(self) -> float:
        """Time constant with which a joint follows its target [s]."""
        return self.kd / self.kp

    @property
    def joint_signs(self) -> np.ndarray:
        """(joints,) signs."""
        return np.array(self.signs)

    @property
    def crouch_pose(self) -> np.ndarray:
        """(joints,) angles [rad]."""
        return np.array(self.crouch)

    @property
    def folded_pose(self) -> np.ndarray:
        """(joints,) angles [rad]."""
        return np.array(self.folded)


@dataclass(frozen=True)
class Drive:
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
    temperature: np.ndarray | None = None  # (joints,) of the motors [°C], if measured
    battery: float | None = None  # [V], if measured
