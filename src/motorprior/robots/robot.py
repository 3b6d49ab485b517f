"""The description of a robot: joints, legs, poses, model, clocks and wire."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from motorprior.exceptions import ConfigError, listed
from motorprior.robots.joint_classes import classes_by_name
from motorprior.robots.model_source import ModelFile
from motorprior.robots.wire import Wire
from motorprior.texts import Overview, Printable

GRAVITY = 9.81  # [m/s²]
Encoder = Literal["joint", "rotor"]


@dataclass(frozen=True)
class Joint:
    """One driven joint with torque = clip(kp·(position_target - joint_pos) - kd·joint_vel, ±torque_limit)."""

    name: str  # of the hinge in the robot's model
    lower: float  # limit [rad]
    upper: float
    kp: float  # nominal gain at the joint [N·m/rad]
    kd: float  # [N·m·s/rad]
    torque_limit: float  # [N·m]


@dataclass(frozen=True)
class Leg:
    """A leg of three joints: abduction about x, hip and knee about y; a growing hip angle moves the foot backwards."""

    name: str
    joints: tuple[int, int, int]  # indices of abduction, hip and knee in the robot's joints
    foot: str  # the geom of the model that touches the ground
    phase: float  # in the trot cycle, in [0, 1)
    thigh: float  # from hip to knee axis [m]
    shank: float  # from knee axis to the centre of the foot [m]
    foot_radius: float  # [m]
    rest: tuple[float, float]  # foot's centre in the nominal pose, forward and left of the base's origin [m]

    def reach(self, joint_pos: np.ndarray) -> tuple[float, float]:
        """Foot's centre forward of and below the hip axis, in the plane of the leg [m], at (joints,) angles [rad].

        forward = -(thigh·sin(hip) + shank·sin(hip + knee)), below = thigh·cos(hip) + shank·cos(hip + knee).
        """
        hip, both = float(joint_pos[self.joints[1]]), float(joint_pos[self.joints[1]] + joint_pos[self.joints[2]])
        forward = -(self.thigh * math.sin(hip) + self.shank * math.sin(both))
        return forward, self.thigh * math.cos(hip) + self.shank * math.cos(both)

    def hip_height(self, joint_pos: np.ndarray) -> float:
        """Distance of the foot's lowest point below the hip axis, body upright [m], at (joints,) angles [rad].

        height = below·cos(abduction) + foot_radius, see `reach`.
        """
        return self.reach(joint_pos)[1] * math.cos(float(joint_pos[self.joints[0]])) + self.foot_radius


@dataclass(frozen=True)
class Gait:
    """Size and frequency of a gait, see `locomotion.body`."""

    frequency: float  # of the steps of one leg, before modulation by the policy [Hz]
    swing_height: float  # lift of a foot in swing [m]
    forward: tuple[float, float]  # minimum (negative: backward) and maximum commanded speed [m/s]
    yaw_rate: float = 0.6  # maximum commanded, both directions [rad/s]
    residual: float = 0.3  # maximum correction of a joint target by the policy [rad]

    @classmethod
    def of_size(cls, hip_height: float) -> "Gait":
        """The gait of a robot of this size, by equal Froude number v²/(g·h).

        frequency = max(3 Hz, 0.32 √(g/h)), swing_height = 0.24 h, forward = (-0.16, 0.5) √(g·h), with height h of
        the hip axes above the ground in the nominal pose [m].
        """
        speed = math.sqrt(GRAVITY * hip_height)
        # position-controlled legs are springs: a Go2's body swings at 2 Hz, and slower steps excite this
        frequency = max(3.0, 0.32 * math.sqrt(GRAVITY / hip_height))
        return cls(round(frequency, 2), round(0.24 * hip_height, 3), (round(-0.16 * speed, 2), round(0.5 * speed, 2)))


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
    encoder: Encoder = "joint"  # where angles and velocities are measured; the rotor is before the gear
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
    files: tuple[Path, ...] = ()  # description and model files of a user's robot
    fleets: tuple[tuple[str, str], ...] = ()  # (name, path) of the shipped fleets of its motors, the default first
    physics_dt: float = 0.002  # MuJoCo's step in training [s]
    control_dt: float = 0.01  # period of the policy [s]
    twin_physics_dt: float = 0.001  # MuJoCo's step with physical motors [s]
    wire: Wire | None = None  # protocol constants of the real robot; None if not supported

    def overview(self) -> Overview:
        """For people: motors, joints and size."""
        kp, kd = (sorted({getattr(joint, name) for joint in self.joints}) for name in ("kp", "kd"))
        facts = {
            "motors": self.motor, "joints": listed(self.joint_names, 12), "legs": str(len(self.legs) or ""),
            "kp": f"{listed([f'{each:g}' for each in kp], 4)} N·m/rad",
            "kd": f"{listed([f'{each:g}' for each in kd], 4)} N·m·s/rad",
            "mass": f"{self.weight / GRAVITY:.2f} kg" if self.weight else "",
            "clocks": f"physics {1e3 * self.physics_dt:g} ms, control {1e3 * self.control_dt:g} ms",
        }  # fmt: skip
        return Overview(f"robot {self.name}, {self.base} base", facts)

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
        return self.given_classes or classes_by_name(self.joint_names)

    @property
    def nominal_pose(self) -> np.ndarray:
        """(joints,) angles of the nominal pose [rad]."""
        return np.array(self.nominal)

    def limits_of(self, joint_names: Sequence[str]) -> np.ndarray:
        """(J, 2) lower and upper limits of joints by name [rad]; NaN for unknown joints."""
        known = {joint.name: (joint.lower, joint.upper) for joint in self.joints}
        return np.array([known.get(name, (math.nan, math.nan)) for name in joint_names])

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
        """Physics step [s] for motors that need steps of at most ``max_step`` [s]; inf allows ``physics_dt``."""
        return self.physics_dt if math.isinf(max_step) else min(max_step, self.twin_physics_dt)

    def require_gait(self) -> Gait:
        """The gait of a robot that can walk; raises ConfigError for one with a fixed base or without suitable legs."""
        problem, remedy = self.leg_mismatch, "change axes and zeros in its model as in docs/your-robot.md"
        if self.gait is None or self.base != "free":
            problem = f"it has {len(self.legs)} legs and a {self.base} base"
            remedy = "give a robot with a free base and tables [legs.…]"
        if self.gait is None or problem:
            raise ConfigError(f"robot {self.name!r} cannot walk: {problem}", remedy=remedy)
        return self.gait

    def with_speed_range(self, forward: tuple[float, float]) -> "Robot":
        """The same robot with another range of commanded speeds [m/s]; raises as `require_gait`."""
        return replace(self, gait=replace(self.require_gait(), forward=forward))

    def require_wire(self) -> Wire:
        """The protocol constants of the real robot; raises ConfigError if they are unknown."""
        if self.wire is None:
            raise ConfigError(f"the protocol of robot {self.name!r} is not supported", remedy="use a shipped robot")
        return self.wire
