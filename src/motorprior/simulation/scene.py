"""An episode: its settings and its simulation, in either engine."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.registry import DrawMotors
from motorprior.backend import BackendState
from motorprior.bounds import require_count, require_finite
from motorprior.exceptions import ConfigError
from motorprior.locomotion.body import GaitName
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.control_step import SensorErrors, TaskWeights
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.randomization import Randomization
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
        """The robot in the engine, for `begin`."""
        return BulletWorld(self.robot) if self.walk.engine == "pybullet" else World(self.robot, self.physics_dt)

    def begin(self, world: World | BulletWorld, seed: int) -> ActuatorArrays:
        """Stand in the nominal pose on the motors and in the conditions of this seed; returns the motors' arrays."""
        conditions = self.walk.randomization.conditions(self.robot, seed, self.walk.episode_steps)
        return world.reset(self.draw_motors(np.random.default_rng(seed)), conditions=conditions)


class SimulatedBackend:
    """A robot in the engine of a scene, with new motors and conditions in every episode.

    Raises:
        ConfigError: a robot that has no model for the engine.
    """

    def __init__(self, scene: Scene):
        self._scene, self.world = scene, scene.world()
        self._motors: ActuatorArrays | None = None

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose; ``seed`` determines everything random."""
        self._motors = self._scene.begin(self.world, seed)
        return self.world.state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad] for one control step.

        Raises:
            ConfigError: no reset before; another shape, or a target that is not finite.
        """
        if self._motors is None:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        target = require_finite("position_target", position_target, (self._scene.robot.num_joints,))
        return self.world.state(self._motors, self.world.hold(self._motors, target))

    def close(self) -> None:
        """Close the engine."""
        self.world.close()
