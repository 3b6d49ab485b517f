"""An episode: its settings and its simulation, in either engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, Factors, with_factors
from motorprior.bounds import require_count, require_number
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands, Timetable
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.sensing import SensorErrors
from motorprior.locomotion.task import TaskWeights
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import Randomization

if TYPE_CHECKING:
    from motorprior.simulation.backend import SimulatedBackend
    from motorprior.simulation.bullet_world import BulletWorld
    from motorprior.simulation.env import BackendSimulator
    from motorprior.simulation.rollout import WalkSimulator
    from motorprior.simulation.world import World

DrawMotors: TypeAlias = Callable[[np.random.Generator], Actuator]  # draws the motors of one episode, one per joint
Engine = Literal["mujoco", "pybullet"]
ENGINES: tuple[Engine, ...] = get_args(Engine)
MAX_ROUGHNESS = 0.05  # [m]; the small robot stands 0.17 m high


@dataclass(frozen=True)
class WalkConfig:
    """Settings of a walking episode.

    Raises:
        ConfigError: a number out of range, an unknown engine, or rough ground in MuJoCo.
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
    roughness: float = 0.0
    """Height of the bumps of rough ground [m], up to 4 m from the start; PyBullet only."""

    def __post_init__(self) -> None:
        require_count("episode_steps", self.episode_steps)
        require_number("roughness", self.roughness, 0.0, MAX_ROUGHNESS)
        if self.engine not in ENGINES:
            raise ConfigError(f"engine {self.engine!r} is unknown", remedy=f"use one of {ENGINES}", argument="engine")
        if self.roughness and self.engine != "pybullet":
            problem = f"roughness {self.roughness:g} is for PyBullet only"
            raise ConfigError(problem, remedy="use engine pybullet, or leave it out", argument="roughness")

    def inputs(self, robot: Robot, seed: int) -> tuple[SensorErrors, np.ndarray]:
        """Sensor errors and (steps, 2) commands [m/s], [rad/s] of the episode of this seed."""
        sensors = self.randomization.sensors(robot, seed, self.episode_steps)
        return sensors, self.commands.schedule(robot, seed, self.episode_steps)


@dataclass(frozen=True)
class Scene:
    """Simulation of a walking episode.

    Attributes:
        robot: with legs.
        draw_motors: the motors of an episode, from a generator seeded by the episode's seed.
        walk: settings of the episode.
        physics_dt: MuJoCo's step [s]; the robot's own if not given. PyBullet's is always 1 ms.

    Raises:
        ConfigError: an engine that is not installed, or randomized constants that the motors do not have.
    """

    robot: Robot
    draw_motors: DrawMotors
    walk: WalkConfig = field(default_factory=WalkConfig)
    physics_dt: float | None = None

    def __post_init__(self) -> None:
        if self.walk.engine == "pybullet":
            from motorprior.simulation.bullet_world import import_bullet

            import_bullet()
        same = Factors.ones(self.robot.num_joints)
        for name in Factors._fields:
            if getattr(self.walk.randomization, name) == (1.0, 1.0):
                continue
            try:
                with_factors(self.draw_motors(np.random.default_rng(0)), same._replace(**{name: 0.5 * same.kp}))
            except ConfigError as error:
                argument = error.argument or f"randomization.{name}"
                raise ConfigError(f"{argument}: {error.problem}", remedy=error.remedy, argument=argument) from error

    def world(self) -> World | BulletWorld:
        """The robot in the engine, for `begin`. An engine is imported when it is used."""
        if self.walk.engine == "pybullet":
            from motorprior.simulation.bullet_world import BulletWorld

            return BulletWorld(self.robot, roughness=self.walk.roughness)
        from motorprior.simulation.world import World

        return World(self.robot, self.physics_dt)

    def begin(self, world: World | BulletWorld, seed: int) -> ActuatorArrays:
        """Stand in the nominal pose on the motors and in the conditions of this seed; returns the motors' arrays."""
        conditions = self.walk.randomization.conditions(self.robot, seed, self.walk.episode_steps)
        return world.reset(self.draw_motors(np.random.default_rng(seed)), conditions=conditions, seed=seed)

    def backend(self) -> SimulatedBackend:
        """The episode step by step."""
        from motorprior.simulation.backend import SimulatedBackend

        return SimulatedBackend(self)

    def simulator(self) -> WalkSimulator | BackendSimulator:
        """Simulator of whole episodes, compiled with MuJoCo."""
        if self.walk.engine == "mujoco":
            from motorprior.simulation.rollout import WalkSimulator

            return WalkSimulator(self)
        from motorprior.simulation.env import BackendSimulator

        return BackendSimulator(self.robot, self.backend(), self.walk)
