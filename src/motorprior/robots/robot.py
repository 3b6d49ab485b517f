"""Description of a robot as data: joints, legs, poses, model, clocks and wire."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.robots.model_source import GeneratedModel, ModelFile
from motorprior.robots.wire import Wire

GRAVITY = 9.81
"""Gravitational acceleration [m/s²]."""
Encoder = Literal["joint", "rotor"]


@dataclass(frozen=True)
class Joint:
    """One driven joint; its motor's law is torque = clip(kp·error - kd·joint_vel, ±torque_limit).

    Attributes:
        name: of the hinge in the robot's model.
        lower: limit [rad].
        upper: limit [rad].
        kp: nominal gain at the joint [N·m/rad]; error = position_target - joint_pos.
        kd: nominal gain at the joint [N·m·s/rad].
        torque_limit: [N·m].
        encoder: where angle and velocity are measured, on the "joint" or on the motor's "rotor", before the gear.
    """

    name: str
    lower: float
    upper: float
    kp: float
    kd: float
    torque_limit: float
    encoder: Encoder = "joint"


@dataclass(frozen=True)
class Leg:
    """One leg of three joints: abduction about x, hip and knee about y; a growing hip angle carries the foot back.

    Attributes:
        name: of the leg.
        joints: places of abduction, hip and knee among the robot's joints.
        foot: the geom in the robot's model that touches the ground.
        phase: of the leg within a trot's cycle, in [0, 1).
        thigh: from hip to knee axis [m].
        shank: from knee axis to the centre of the foot [m].
        foot_radius: [m].
        rest: where the foot's centre is in the nominal pose, forward and left of the base's origin [m].
    """

    name: str
    joints: tuple[int, int, int]
    foot: str
    phase: float
    thigh: float
    shank: float
    foot_radius: float
    rest: tuple[float, float]

    def reach(self, joint_pos: np.ndarray) -> tuple[float, float]:
        """Foot's centre forward of and below the hip axis in the plane of the leg [m].

        forward = -(thigh·sin(hip) + shank·sin(hip + knee)), below = thigh·cos(hip) + shank·cos(hip + knee).

        Args:
            joint_pos: (joints,) of the robot [rad].
        """
        hip, both = float(joint_pos[self.joints[1]]), float(joint_pos[self.joints[1]] + joint_pos[self.joints[2]])
        forward = -(self.thigh * math.sin(hip) + self.shank * math.sin(both))
        return forward, self.thigh * math.cos(hip) + self.shank * math.cos(both)

    def drop(self, joint_pos: np.ndarray) -> float:
        """Distance of the foot's lowest point below the hip axis [m] of an upright body.

        below·cos(abduction) + foot_radius, see `reach`.

        Args:
            joint_pos: (joints,) of the robot [rad].
        """
        return self.reach(joint_pos)[1] * math.cos(float(joint_pos[self.joints[0]])) + self.foot_radius


@dataclass(frozen=True)
class Gait:
    """Size and clock of a robot's gait, see `locomotion.trajectory_generator`.

    Attributes:
        frequency: of the steps of one leg before the policy modulates it [Hz].
        swing_height: lift of a foot in swing [m].
        forward: slowest (negative: backward) and fastest speed that is commanded [m/s].
        yaw_rate: fastest turn that is commanded to either side [rad/s].
        residual: largest correction of a joint target by the policy [rad].
    """

    frequency: float
    swing_height: float
    forward: tuple[float, float]
    yaw_rate: float = 0.6
    residual: float = 0.3

    @classmethod
    def of_size(cls, hip_height: float) -> Gait:
        """The gait of a robot of this size; robots of equal Froude number v² / (g·h) move alike.

        frequency = max(3 Hz, 0.32 √(g/h)), swing_height = 0.24 h, forward = (-0.16, 0.5) √(g·h); our choice. From hips
        of 0.11 m on every robot has 3 Hz, measured on a Unitree Go2: its position-controlled legs are springs on which
        the body swings at about 2 Hz, and steps of that frequency rock it. Smaller robots step faster, as Froude's
        number says; none was measured.

        Args:
            hip_height: h, of the hip axes over the ground in the nominal pose [m].
        """
        speed = math.sqrt(GRAVITY * hip_height)
        frequency = max(3.0, 0.32 * math.sqrt(GRAVITY / hip_height))
        return cls(round(frequency, 2), round(0.24 * hip_height, 3), (round(-0.16 * speed, 2), round(0.5 * speed, 2)))


@dataclass(frozen=True)
class Robot:
    """Everything that the library knows of one robot. Arrays are new copies in the order of ``joints``.

    Attributes:
        name: short; priors, policies and logs carry it.
        motor: name of the motors.
        joints: in the order of the model; they are the model's last coordinates.
        base: "free" where the body moves in space, "fixed" where it is mounted.
        model: MJCF, generated or a file.
        num_links: moving bodies of the model, the base of a free robot among them.
        nominal: joint angles of the standing or resting pose [rad].
        legs: none for an arm.
        gait: size and clock of its gait; None without legs.
        unlike: what in its legs is not as `Leg` says, so that it cannot walk; nothing if nothing is.
        weight: of the whole robot [N]; 0 where it is not known and does not matter.
        standing_height: of the base over the ground in the nominal pose [m].
        lowest: height of the base below which a walking robot has fallen [m].
        highest: height of the base above which the simulation has failed [m].
        suspended_height: of the base of a robot that hangs in the air [m].
        reference_torque: load of a joint that the walking reward's torque penalty counts as 1 [N·m].
        foot_friction: sliding friction of the feet [-].
        load_inertia: least and most inertia that one of its motors carries [kg·m²], from a bare last link to the
            standing robot; a bench draws its loads between them.
        files: of a user's robot, its description and those of its model.
        fleets: (name, path) of the shipped populations of its motors, the default first.
        physics_dt: MuJoCo's step in training [s].
        control_dt: period of the policy [s].
        twin_physics_dt: MuJoCo's step of the twin [s].
        wire: how a host talks to the real robot; None where this library cannot.
    """

    name: str
    motor: str
    joints: tuple[Joint, ...]
    base: Literal["free", "fixed"]
    model: GeneratedModel | ModelFile
    num_links: int
    nominal: tuple[float, ...]
    legs: tuple[Leg, ...] = ()
    gait: Gait | None = None
    unlike: str = ""
    weight: float = 0.0
    standing_height: float = 0.0
    lowest: float = 0.0
    highest: float = 1e3
    suspended_height: float = 0.0
    reference_torque: float = 1.0
    foot_friction: float = 0.6
    load_inertia: tuple[float, float] = (1e-4, 3e-2)
    files: tuple[Path, ...] = ()
    fleets: tuple[tuple[str, str], ...] = ()
    physics_dt: float = 0.002
    control_dt: float = 0.01
    twin_physics_dt: float = 0.001
    wire: Wire | None = None

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def nominal_pose(self) -> np.ndarray:
        """(joints,) angles of the nominal pose [rad]."""
        return np.array(self.nominal)

    @property
    def limits(self) -> np.ndarray:
        """(joints, 2) lower and upper limit [rad]."""
        return np.array([(joint.lower, joint.upper) for joint in self.joints])

    def limits_of(self, joint_names: Sequence[str]) -> np.ndarray:
        """(J, 2) lower and upper limit of some joints by name [rad]; NaN of those that it does not have."""
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
    def encoder(self) -> Encoder:
        """Where this robot's logs are measured."""
        return self.joints[0].encoder

    @property
    def default_fleet(self) -> str:
        """Name of the shipped population of its motors.

        Raises:
            ConfigError: none is shipped.
        """
        if not self.fleets:
            raise ConfigError(
                f"robot {self.name!r} comes without motors", remedy="give the .toml file of some as fleet",
                argument="fleet",
            )  # fmt: skip
        return self.fleets[0][0]

    def physics_step(self, longest: float) -> float:
        """Physics step [s] for motors that allow at most ``longest`` [s].

        The robot's own for motors that allow any; otherwise ``twin_physics_dt``, or ``longest`` if that is shorter.
        """
        return self.physics_dt if math.isinf(longest) else min(longest, self.twin_physics_dt)

    def require_legs(self) -> Gait:
        """The gait of a robot that can walk.

        Raises:
            ConfigError: it has no legs or a fixed base.
        """
        if self.gait is None or not self.legs or self.base != "free":
            raise ConfigError(
                f"robot {self.name!r} cannot walk: it has {len(self.legs)} legs and a {self.base} base",
                remedy="give a robot with a free base and a table [legs] in its file",
            )
        if self.unlike:
            raise ConfigError(
                f"robot {self.name!r} cannot walk: {self.unlike}",
                remedy="turn the joints' axes and zeros in its model as docs/your-robot.md says",
            )
        return self.gait

    def with_speeds(self, forward: tuple[float, float]) -> Robot:
        """The same robot, told speeds within this range [m/s] instead of its usual one.

        Raises:
            ConfigError: it cannot walk.
        """
        return replace(self, gait=replace(self.require_legs(), forward=forward))

    def require_wire(self) -> Wire:
        """The wire of the real robot.

        Raises:
            ConfigError: this library cannot talk to that robot.
        """
        if self.wire is None:
            raise ConfigError(f"robot {self.name!r} has no wire that motorprior speaks", remedy="use a shipped robot")
        return self.wire
