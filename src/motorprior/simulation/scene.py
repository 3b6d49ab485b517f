"""An episode: its settings and its simulation, in either engine."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.registry import DrawMotors
from motorprior.bounds import require_count
from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import GaitName
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.task import SensorErrors, TaskWeights
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import Randomization

if TYPE_CHECKING:
    from motorprior.simulation.bullet_world import BulletWorld
    from motorprior.simulation.env import BackendSimulator, SimulatedBackend
    from motorprior.simulation.rollout import WalkSimulator
    from motorprior.simulation.world import World

Engine = Literal["mujoco", "pybullet"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True)
class WalkConfig:
    """Settings of a walking episode.

    Raises:
        ConfigError: a number out of range, or an unknown engine.
    """

    episode_steps: int = 500
    """Control steps until the time limit."""
    task: TaskWeights = field(default_factory=TaskWeights)
    """Reward."""
    randomization: Randomization = field(default_factory=Randomization)
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors, pushes."""
    commands: Commands | Timetable = field(default_factory=Commands)
    """Commanded speeds and yaw rates, also above the robot's usual range."""
    gait: GaitName = "trot"
    """Gait: phases of the legs."""
    engine: Engine = "mujoco"
    """Physics engine; PyBullet holds the interpreter lock, so that only the executor ray uses several cores."""

    def __post_init__(self) -> None:
        require_count("episode_steps", self.episode_steps)
        if self.engine not in ENGINES:
            raise ConfigError(f"engine {self.engine!r} is unknown", remedy=f"use one of {ENGINES}", argument="engine")

    def inputs(self, robot: Robot, seed: int) -> tuple[SensorErrors, np.ndarray]:
        """Sensor errors and (steps, 2) commands [m/s], [rad/s] of the episode of this seed."""
        sensors = self.randomization.sensors(robot, seed, self.episode_steps)
        return sensors, self.commands.schedule(robot, seed, self.episode_steps)


@dataclass(frozen=True)
class Scene:
    """Simulation of a walking episode."""

    robot: Robot
    """With legs."""
    draw_motors: DrawMotors
    """The motors of an episode, from a generator seeded by the episode's seed."""
    walk: WalkConfig = field(default_factory=WalkConfig)
    physics_dt: float | None = None
    """MuJoCo's step [s]; the robot's own if not given. PyBullet's is always 1 ms."""

    def world(self) -> World | BulletWorld:
        """The robot in the engine, for `begin`. An engine is imported when it is used."""
        if self.walk.engine == "pybullet":
            from motorprior.simulation.bullet_world import BulletWorld

            return BulletWorld(self.robot)
        from motorprior.simulation.world import World

        return World(self.robot, self.physics_dt)

    def begin(self, world: World | BulletWorld, seed: int) -> ActuatorArrays:
        """Stand in the nominal pose on the motors and in the conditions of this seed; returns the motors' arrays."""
        conditions = self.walk.randomization.conditions(self.robot, seed, self.walk.episode_steps)
        return world.reset(self.draw_motors(np.random.default_rng(seed)), conditions=conditions)

    def backend(self) -> SimulatedBackend:
        """The episode step by step."""
        from motorprior.simulation.env import SimulatedBackend

        return SimulatedBackend(self)

    def simulator(self) -> WalkSimulator | BackendSimulator:
        """Simulator of whole episodes, compiled with MuJoCo."""
        if self.walk.engine == "mujoco":
            from motorprior.simulation.rollout import WalkSimulator

            return WalkSimulator(self)
        from motorprior.simulation.env import BackendSimulator

        return BackendSimulator(self.robot, self.backend(), self.walk)
