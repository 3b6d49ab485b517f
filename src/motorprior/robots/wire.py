"""How a host talks to a real robot: what its numbers mean, and what the host lets pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SafetyLimits:
    """What the host lets pass to this robot, and what it calls a fault, with the reasons.

    Attributes:
        target_speed: fastest change of a position target [rad/s]. Gaits are held to 40, which they reach when a swing
            begins; the motors themselves end at 52.
        slow_speed: the same while ramping and crouching [rad/s].
        max_current: [A] per motor, the 2022 deployment.
        highest_kp: [A/rad]; highest_kd: [A·s/rad]: above the gains of every known deployment.
        highest_kd: see highest_kp.
        max_tilt: |roll| or |pitch| beyond which the robot is falling [rad]; training episodes end at 0.4, walking stays
            below 0.15.
        tilt_time: for so long [s]: one damaged frame is no fall.
        imu_time: an IMU that repeats itself for so long [s] is frozen: a sensor has noise.
        tracking_error: between a joint and its target after a first-order lag of kd/kp [rad]. Five policies on
            twelve twins each exceeded 0.45 for at most 0.2 s.
        tracking_time: for so long [s].
        stuck_motion: a joint that moved less than this [rad] while its lagged target moved by ``stuck_target`` ...
        stuck_target: ... [rad] ...
        stuck_time: ... within this time [s] has a frozen encoder or is blocked. On the same twins a joint that stood
            still for so long was led at most 0.09 rad.
        telemetry_age: oldest measurement that may be acted on [s].
        implausible_frames: so many impossible frames in a row are no noise on the line.
        joint_speed: fastest believable joint [rad/s]; walking stays below 13.
        body_rate: fastest believable rotation of the body [rad/s], the range of the gyroscope (2000 °/s).
        measured_current: of any motor [A], where it is sent; the firmware itself gives up at 10.
        current_time: for so long [s]; one damaged frame is no overcurrent.
        temperature: of any motor [°C], where it is sent; assumption, the motors' windings take about 100.
        battery: lowest voltage [V], where it is sent; assumption, 3.3 V for each of six cells.
        warning_time: temperature or battery beyond their bounds for so long [s].
        tick_delay: longest delay of one control step [s], while the motors hold the last target: every walk of a policy
            of 150 iterations stayed upright through so long a pause, and through twice that; policies that were trained
            less may survive less.
        late_ticks: so many late steps (by more than half a period) of the last hundred are a host that cannot keep up.
        stalled_time: so much lateness [s] of the last hundred steps together is another one; all walks of that policy
            with a pause of 20 ms at every tenth step stayed upright, with 50 ms 3 of 24 fell.
        watchdog: the watchdog process sends idle when the host is silent for so long [s]: a control period, the longest
            delay, and 20 ms for a host that wakes up to send.
    """

    target_speed: float = 60.0
    slow_speed: float = 1.5
    max_current: float = 7.0
    highest_kp: float = 60.0
    highest_kd: float = 6.0
    max_tilt: float = 0.7
    tilt_time: float = 0.03
    imu_time: float = 0.3
    tracking_error: float = 0.6
    tracking_time: float = 0.25
    stuck_motion: float = 0.004
    stuck_target: float = 0.2
    stuck_time: float = 0.25
    telemetry_age: float = 0.1
    implausible_frames: int = 3
    joint_speed: float = 20.0
    body_rate: float = 35.0
    measured_current: float = 9.0
    current_time: float = 0.02
    temperature: float = 80.0
    battery: float = 19.8
    warning_time: float = 0.3
    tick_delay: float = 0.1
    late_ticks: int = 10
    stalled_time: float = 0.2
    watchdog: float = 0.13


@dataclass(frozen=True)
class Wire:
    """A servo bus that takes position targets and gains and answers with angles.

    The law on the robot: current = clip(kp·(target - angle) - kd·velocity, ±max_current).

    Attributes:
        kp: gain in force when nothing else is asked for [A/rad].
        kd: the same [A·s/rad]; kd acts on the absolute velocity, so a joint follows its target like a first-order
            low-pass with time constant kd/kp.
        max_current: [A] per motor.
        torque_constant: [N·m/A] at the joint.
        signs: robot's own angle = sign × angle of the model, per joint.
        encoder_counts: per turn of the joint.
        crouch: joint angles from which losing current is soft [rad].
        folded: joint angles of a robot that lies on its belly, switched off [rad].
        safety: bounds that the host keeps.
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
