"""The description of a robot: joints, legs, poses, model, clocks, protocol and safety limits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from motorprior.exceptions import ConfigError, listed
from motorprior.robots.joint_classes import motor_classes
from motorprior.robots.model_source import ModelFile
from motorprior.robots.motor_models import MotorModel
from motorprior.robots.servos import ServoChain
from motorprior.texts import Overview, Printable

GRAVITY = 9.81  # [m/s²]
Encoder = Literal["joint", "rotor"]


@dataclass(frozen=True)
class Joint:
    """One driven joint.

    torque = clip(kp·(position_target - joint_pos) - kd·joint_vel, ±torque_limit)
    """

    name: str  # name of the hinge in the robot's model
    lower: float  # lower limit [rad]
    upper: float  # upper limit [rad]
    kp: float  # nominal gain at the joint [N·m/rad]; NaN if the description has none
    kd: float  # [N·m·s/rad]; NaN as kp
    torque_limit: float  # [N·m]


@dataclass(frozen=True)
class Leg:
    """A leg of three joints: abduction about x, hip and knee about y.

    A growing hip angle moves the foot backwards.
    """

    name: str
    joints: tuple[int, int, int]  # indices of abduction, hip and knee in the robot's joints
    foot: str  # the geom of the model that touches the ground
    phase: float  # in the trot cycle, in [0, 1)
    thigh: float  # from hip to knee axis [m]
    shank: float  # from knee axis to the centre of the foot [m]
    foot_radius: float  # [m]
    # foot's centre in the nominal pose, forward and left of the base's origin [m]
    rest: tuple[float, float]

    def reach(self, joint_pos: np.ndarray) -> tuple[float, float]:
        """Foot's centre forward of and below the hip axis [m], at (joints,) angles [rad].

        In the plane of the leg,

            forward = -(thigh·sin(hip) + shank·sin(hip + knee)),
            below = thigh·cos(hip) + shank·cos(hip + knee).
        """
        hip = float(joint_pos[self.joints[1]])
        hip_and_knee = float(joint_pos[self.joints[1]] + joint_pos[self.joints[2]])
        forward = -(self.thigh * math.sin(hip) + self.shank * math.sin(hip_and_knee))
        below = self.thigh * math.cos(hip) + self.shank * math.cos(hip_and_knee)
        return forward, below

    def hip_height(self, joint_pos: np.ndarray) -> float:
        """Height of the hip axis above the foot's lowest point [m], at (joints,) angles [rad].

        The body is upright. height = below·cos(abduction) + foot_radius, see `reach`.
        """
        _, below = self.reach(joint_pos)
        abduction = float(joint_pos[self.joints[0]])
        return below * math.cos(abduction) + self.foot_radius


@dataclass(frozen=True)
class Gait:
    """Size and frequency of a gait, see `locomotion.gait`."""

    frequency: float  # of the steps of one leg, before modulation by the policy [Hz]
    swing_height: float  # lift of a foot in swing [m]
    forward: tuple[float, float]  # minimum (negative: backward) and maximum commanded speed [m/s]
    yaw_rate: float = 0.6  # maximum commanded, both directions [rad/s]
    residual: float = 0.3  # maximum correction of a joint target by the policy [rad]

    @classmethod
    def of_size(cls, hip_height: float) -> "Gait":
        """The gait of a robot of this size, by equal Froude number v²/(g·h).

        frequency = max(3 Hz, 0.32 √(g/h)), swing_height = 0.24 h, forward = (-0.16, 0.5) √(g·h),
        with height h of the hip axes above the ground in the nominal pose [m].
        """
        speed = math.sqrt(GRAVITY * hip_height)
        # position-controlled legs are springs: a Go2's body swings at 2 Hz, and slower steps excite
        # this
        frequency = max(3.0, 0.32 * math.sqrt(GRAVITY / hip_height))
        return cls(
            round(frequency, 2),
            round(0.24 * hip_height, 3),
            (round(-0.16 * speed, 2), round(0.5 * speed, 2)),
        )


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of the host's safety gate and fault detection."""

    # Maximum position targets, currents and gains
    # [rad/s]; gaits reach 40 at the start of a swing; the motors' no-load speed is 52
    target_speed: float = 60.0
    slow_speed: float = 1.5  # [rad/s] while ramping and crouching
    max_current: float = 7.0  # [A] per motor; 2022 deployment
    max_kp: float = 60.0  # [A/rad]; above the gains of every known deployment
    max_kd: float = 6.0  # [A·s/rad]
    # Falls: |roll| or |pitch| beyond max_tilt [rad] for tilt_time [s]; an IMU that repeats its
    # reading for imu_time [s]
    max_tilt: float = 0.7  # training episodes end at 0.4, walking stays below 0.15
    tilt_time: float = 0.03  # one damaged frame is not a fall
    imu_time: float = 0.3  # a working sensor has noise
    # Error of a joint against its target with a first-order lag of kd/kp [rad], for tracking_time
    # [s]
    tracking_error: float = 0.6  # five policies on twelve twins exceeded 0.45 for at most 0.2 s
    tracking_time: float = 0.25
    # Blocked, or a frozen encoder: moves less than stuck_motion while its lagged target moves by
    # stuck_target [rad]
    stuck_motion: float = 0.004
    stuck_target: float = 0.2  # on these twins, targets led a static joint by at most 0.09 rad
    stuck_time: float = 0.25  # [s]
    # Telemetry
    telemetry_age: float = 0.1  # maximum age of a measurement in use [s]
    implausible_frames: int = 3  # so many in a row are a fault
    joint_speed: float = 20.0  # maximum plausible [rad/s]; walking stays below 13
    body_rate: float = 35.0  # maximum plausible [rad/s]; range of the gyroscope, 2000 °/s
    # [A], if reported, of any motor for current_time [s]; the firmware stops at 10
    measured_current: float = 9.0
    current_time: float = 0.02  # one damaged frame is not an overcurrent
    # Late control steps; the motors hold the last target meanwhile
    # of one step [s]; walks of a policy of 150 iterations stayed upright with twice this pause
    tick_delay: float = 0.1
    late_ticks: int = 10  # steps of the last hundred that are late by more than half a period
    # their total lateness [s]; with 20 ms every tenth step no walk fell, with 50 ms 3 of 24
    stalled_time: float = 0.2
    # the host is silent [s]: idle; a control period, tick_delay, and 20 ms for the host to send
    watchdog: float = 0.13


@dataclass(frozen=True, eq=False)
class Wire:
    """Constants of a servo bus.

    On the robot, current = clip(kp·(target - angle) - kd·velocity, ±max_current).
    """

    kp: float  # default gain [A/rad]
    # default gain [A·s/rad]; it acts on the velocity, so a joint follows its target with a lag of
    # kd/kp
    kd: float
    max_current: float  # [A] per motor
    torque_constant: float  # [N·m/A] at the joint
    joint_signs: np.ndarray  # (joints,) robot's own angle = sign × angle of the model
    encoder_counts: int  # per turn of the joint
    # (joints,) angles in which the current can be switched off softly [rad]
    crouch_pose: np.ndarray
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
        current = self.kp * (self.target - joint_pos) - self.kd * joint_vel
        return np.clip(current, -self.max_current, self.max_current)


@dataclass(frozen=True)
class SensorReadings:
    """Sensor readings of a robot, joints in the robot's signs."""

    pos: np.ndarray  # (joints,) [rad]
    vel: np.ndarray  # (joints,) [rad/s]
    current: np.ndarray  # (joints,) [A]
    attitude: np.ndarray  # roll, pitch, yaw [rad]
    rates: np.ndarray  # about the body's axes [rad/s]


@dataclass(frozen=True, repr=False)
class Robot(Printable):
    """A robot. Array properties are new copies in the order of ``joints``."""

    name: str  # short name, stored in priors, policies and logs
    motor: str  # name of the motors
    joints: tuple[Joint, ...]  # in the order of the model; they are the model's last coordinates
    base: Literal["free", "fixed"]  # "free" or "fixed"
    model: ModelFile
    num_links: int  # moving bodies of the model, including a free base
    nominal: tuple[float, ...]  # joint angles of the standing or resting pose [rad]
    # where angles and velocities are measured; the rotor is before the gear
    encoder: Encoder = "joint"
    legs: tuple[Leg, ...] = ()  # none for an arm
    gait: Gait | None = None  # None without legs
    # how a leg differs from `Leg`'s conventions, so that the robot cannot walk; empty if none does
    leg_mismatch: str = ""
    weight: float = 0.0  # weight of the whole robot [N]; 0 if unknown
    standing_height: float = 0.0  # height of the base above the ground in the nominal pose [m]
    min_base_height: float = 0.0  # base height below which a walking robot has fallen [m]
    max_base_height: float = 1e3  # base height above which the simulation has failed [m]
    suspended_height: float = 0.0  # base height of a suspended robot [m]
    reference_torque: float = 1.0  # joint torque with penalty 1 in the walking reward [N·m]
    foot_friction: float = 0.6  # sliding friction of the feet [-]
    # minimum and maximum load inertia of one motor [kg·m²]; a bench samples between them
    load_inertia: tuple[float, float] = (1e-4, 3e-2)
    given_classes: tuple[str, ...] = ()  # `joint_classes`; none: by the joints' names
    motor_models: tuple[MotorModel, ...] = ()  # of each joint; none: unknown
    files: tuple[Path, ...] = ()  # description and model files of a user's robot
    # (name, path) of the shipped fleets of its motors, the default first
    fleets: tuple[tuple[str, str], ...] = ()
    physics_dt: float = 0.002  # MuJoCo's step in training [s]
    control_dt: float = 0.01  # period of the policy [s]
    twin_physics_dt: float = 0.001  # MuJoCo's step with physical motors [s]
    wire: Wire | None = None  # protocol constants of the real robot; None if not supported
    servos: ServoChain | None = None  # None if its motors are not on a servo bus, or unknown

    def overview(self) -> Overview:
        """For people: motors, joints and size."""
        gains = self.gains
        if gains is None:
            gain_facts = {"gains": "none; a fit identifies them"}
        else:
            kp, kd = ([f"{value:g}" for value in np.unique(row)] for row in gains)
            gain_facts = {"kp": f"{listed(kp, 4)} N·m/rad", "kd": f"{listed(kd, 4)} N·m·s/rad"}
        facts = {
            "motors": self.motor,
            "joints": listed(self.joint_names, 12),
            "legs": str(len(self.legs) or ""),
            **gain_facts,
            "mass": f"{self.weight / GRAVITY:.2f} kg" if self.weight else "",
            "clocks": f"physics {1e3 * self.physics_dt:g} ms, control {1e3 * self.control_dt:g} ms",
        }
        return Overview(f"robot {self.name}, {self.base} base", facts)

    @property
    def gains(self) -> np.ndarray | None:
        """(2, joints) nominal kp [N·m/rad] and kd [N·m·s/rad]; None if the description has none."""
        kp = [joint.kp for joint in self.joints]
        kd = [joint.kd for joint in self.joints]
        return None if np.isnan([kp, kd]).any() else np.array([kp, kd])

    def require_gains(self) -> np.ndarray:
        """The nominal gains, as `gains`; raises ConfigError if the description has none."""
        gains = self.gains
        if gains is None:
            raise ConfigError(
                f"the file of robot {self.name!r} has no gains",
                remedy="give kp [N·m/rad] and kd [N·m·s/rad] there, or use motors of a prior",
            )
        return gains

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def joint_classes(self) -> tuple[str, ...]:
        """Class of each joint; motors of one class are sampled from one distribution."""
        return motor_classes(self.joint_names, self.given_classes)

    @property
    def nominal_pose(self) -> np.ndarray:
        """(joints,) angles of the nominal pose [rad]."""
        return np.array(self.nominal)

    def limits_of(self, joint_names: Sequence[str]) -> np.ndarray:
        """(J, 2) lower and upper limits of joints by name [rad]; NaN for unknown joints."""
        limits = {joint.name: (joint.lower, joint.upper) for joint in self.joints}
        return np.array([limits.get(name, (math.nan, math.nan)) for name in joint_names])

    @property
    def lower(self) -> np.ndarray:
        """(joints,) lower limits [rad]."""
        return np.array([joint.lower for joint in self.joints])

    @property
    def upper(self) -> np.ndarray:
        """(joints,) upper limits [rad]."""
        return np.array([joint.upper for joint in self.joints])

    @property
    def default_fleet(self) -> str:
        """Name of the shipped fleet of its motors; raises ConfigError if none is shipped."""
        if not self.fleets:
            problem = f"no fleet is shipped for robot {self.name!r}"
            raise ConfigError(problem, remedy="give a .toml file as fleet", argument="fleet")
        return self.fleets[0][0]

    def physics_step(self, max_step: float) -> float:
        """Physics step [s] for motors that need steps of at most ``max_step`` [s].

        Motors that run at any step, ``max_step`` inf, get ``physics_dt``.
        """
        return self.physics_dt if math.isinf(max_step) else min(max_step, self.twin_physics_dt)

    def require_gait(self) -> Gait:
        """The gait of a robot that can walk.

        Raises ConfigError for a fixed base, or without suitable legs.
        """
        problem = self.leg_mismatch
        remedy = "change axes and zeros in its model as in docs/your-robot.md"
        if self.gait is None or self.base != "free":
            problem = f"it has {len(self.legs)} legs and a {self.base} base"
            remedy = "give a robot with a free base and tables [legs.…]"
        if self.gait is None or problem:
            raise ConfigError(f"robot {self.name!r} cannot walk: {problem}", remedy=remedy)
        return self.gait

    def with_speed_range(self, forward: tuple[float, float]) -> "Robot":
        """The same robot with another range of commanded speeds [m/s]; raises as `require_gait`."""
        return replace(self, gait=replace(self.require_gait(), forward=forward))

    def require_servos(self) -> ServoChain:
        """The servos of the real robot; raises ConfigError if they are unknown."""
        if self.servos is None:
            raise ConfigError(
                f"the servos of robot {self.name!r} are unknown",
                remedy="add a table [servos] to its .toml file (docs/hardware.md)",
            )
        return self.servos

    def require_wire(self) -> Wire:
        """The protocol constants of the real robot; raises ConfigError if they are unknown."""
        if self.wire is None:
            raise ConfigError(
                f"the protocol of robot {self.name!r} is not supported",
                remedy="use pupper_v2; to record servos, add a table [servos] to the robot's .toml "
                "file (docs/hardware.md)",
            )
        return self.wire
