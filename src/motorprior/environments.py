"""Gymnasium environments: importing this module registers ``motorprior/Walk-v0``.

    import gymnasium, motorprior.environments
    env = gymnasium.make("motorprior/Walk-v0", engine="mujoco", motors="prior:prior.safetensors")

Options, observations and actions are those of ``motorprior walk``, except two defaults: the motors are the physical
ones of the robot's fleet, and nothing else is randomized.

A fatal error of MuJoCo (out of memory, a broken model) ends the process, since compiled code cannot raise: save your
training from time to time.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium

from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.env import WalkEnv
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.task import TaskWeights
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.engines import Scene
from motorprior.simulation.motors import MotorSource, motor_sampler
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.vector_env import WalkVectorEnv
from motorprior.simulation.world_config import WorldConfig

ENV_ID = "motorprior/Walk-v0"


def make_scene(
    robot: str | Path | Robot = DEFAULT_ROBOT,
    motors: MotorSource = "fleet",
    *,
    engine: str = "mujoco",
    task: TaskWeights | None = None,
    randomization: Randomization | None = None,
    commands: Commands | None = None,
    gait: GaitName = "trot",
    roughness: float = 0.0,
    episode_steps: int = 500,
) -> Scene:
    """The simulation of an environment.

    Args:
        robot: a legged robot: its name, the path of a .toml file, or a robot from `load_robot`.
        motors: motors of the episodes: a text such as "prior:FILE", "pd:kp=9" or "fleet", the robot's own physical
            motors (`actuator.registry`); a prior, a posterior or a fleet to sample; fixed motors; or a function that
            samples them with a generator.
        engine: "mujoco" or "pybullet".
        task: reward.
        randomization: what is sampled per episode, in addition to the motors.
        commands: speed and yaw rate, sampled for every episode; the robot's whole range if not given.
        gait: trot, walk, pace, bound or pronk.
        roughness: height of bumps [m], up to 4 m from the start; PyBullet only.
        episode_steps: control steps until truncation.

    Raises:
        ConfigError, ArtifactError: settings that do not fit together, or a file that cannot be used.
        TypeError: an unknown option.
    """
    commands = commands or Commands()
    robot = commands.extend_range(as_robot(robot))
    walk = WalkConfig(episode_steps, task or TaskWeights(), randomization or Randomization(), commands, gait)
    draw_motors, physics_dt = motor_sampler(motors, robot)
    return Scene(robot, engine, draw_motors, physics_dt, walk, Terrain(roughness))


def make_env(robot: str | Path | Robot = DEFAULT_ROBOT, motors: MotorSource = "fleet", **options: Any) -> WalkEnv:
    """Make one Gymnasium environment that samples new motors in each episode; see `make_scene` for the options.

    Its observations and actions are those of the policies of `train_policy`.
    """
    scene = make_scene(robot, motors, **options)
    walk, sensors = scene.walk, partial(scene.walk.randomization.sensors, scene.robot)
    return WalkEnv(scene.robot, scene.backend(), walk.task, walk.episode_steps, sensors, walk.commands, walk.gait)


def make_vector_env(
    robot: str | Path | Robot = DEFAULT_ROBOT,
    motors: MotorSource = "fleet",
    *,
    num_envs: int = 1,
    threads: int = 1,
    **options: Any,
) -> WalkVectorEnv:
    """Make ``num_envs`` environments in one, stepped by compiled code on ``threads`` threads; see `make_scene`.

    Raises:
        ConfigError, ArtifactError, TypeError: see `make_scene`; or another engine than MuJoCo.
    """
    scene = make_scene(robot, motors, **options)
    if scene.engine != "mujoco":
        raise ConfigError(
            f"vector environments are for MuJoCo, not {scene.engine!r}", remedy='use vectorization_mode="async"'
        )
    world = WorldConfig.of(scene.robot, physics_dt=scene.physics_dt)
    return WalkVectorEnv(num_envs, scene.draw_motors, world, scene.walk, threads)


gymnasium.register(
    ENV_ID,
    entry_point="motorprior.environments:make_env",
    vector_entry_point="motorprior.environments:make_vector_env",
)
