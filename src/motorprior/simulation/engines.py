"""Choice of the physics engine of an episode."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from motorprior.actuator.actuator import Factors, with_factors
from motorprior.backend import Backend
from motorprior.exceptions import ConfigError
from motorprior.robots.robot import Robot
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.bullet_backend import PybulletBackend
from motorprior.simulation.bullet_world import PHYSICS_DT, import_bullet
from motorprior.simulation.mujoco_backend import DrawMotors, MujocoBackend
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.world_config import WorldConfig

Engine = Literal["mujoco", "pybullet"]
ENGINES: tuple[Engine, ...] = get_args(Engine)


@dataclass(frozen=True)
class Scene:
    """Simulation of a walking episode.

    Attributes:
        robot: with legs.
        engine: "mujoco" or "pybullet".
        draw_motors: the motors of an episode.
        physics_dt: MuJoCo's step [s]; PyBullet's is always 1 ms.
        walk: the episode and its randomization.
        terrain: the ground; rough in PyBullet only.

    Raises:
        ConfigError: an engine that is unknown, not installed, or does not support the terrain; randomized constants
            that the motors do not have.
    """

    robot: Robot
    engine: str
    draw_motors: DrawMotors
    physics_dt: float
    walk: WalkConfig = field(default_factory=WalkConfig)
    terrain: Terrain = field(default_factory=Terrain)

    def __post_init__(self) -> None:
        if self.engine not in ENGINES:
            raise ConfigError(f"engine {self.engine!r} is unknown", remedy=f"use one of {ENGINES}")
        if self.engine == "pybullet":
            import_bullet()
        elif self.terrain.roughness:
            raise ConfigError(
                f"roughness {self.terrain.roughness:g} is for PyBullet only",
                remedy="use engine pybullet, or leave it out",
                argument="roughness",
            )
        same = Factors.ones(self.robot.num_joints)
        for name in Factors._fields:
            if getattr(self.walk.randomization, name) == (1.0, 1.0):
                continue
            motors = self.draw_motors(np.random.default_rng(0))
            try:
                with_factors(motors, same._replace(**{name: 0.5 * same.kp}))
            except ConfigError as error:
                argument = error.argument or f"randomization.{name}"
                raise ConfigError(f"{argument}: {error.problem}", remedy=error.remedy, argument=argument) from error

    def backend(self) -> Backend:
        """Backend for Gymnasium."""
        walk = self.walk
        if self.engine == "pybullet":
            world = WorldConfig.of(self.robot, physics_dt=PHYSICS_DT)
            return PybulletBackend(self.draw_motors, world, walk.randomization, self.terrain, walk.episode_steps)
        world = WorldConfig.of(self.robot, physics_dt=self.physics_dt)
        return MujocoBackend(self.draw_motors, world, walk.randomization, walk.episode_steps)

    def simulator(self) -> WalkSimulator | BackendSimulator:
        """Simulator of whole episodes for a search, compiled with MuJoCo."""
        if self.engine == "mujoco":
            return WalkSimulator(self.draw_motors, WorldConfig.of(self.robot, physics_dt=self.physics_dt), self.walk)
        return BackendSimulator(self.robot, self.backend(), self.walk)
