"""Gymnasium environments: importing this module registers ``motorprior/Walk-v0``.

    import gymnasium, motorprior.environments
    env = gymnasium.make("motorprior/Walk-v0", engine="mujoco", motors="prior:prior.safetensors")

It has the options, observations and actions of ``motorprior walk``, except two defaults: the robot
has the physical motors of its fleet, and nothing else is randomized. A fatal error of MuJoCo
(out of memory, a broken model) ends the process, since compiled code cannot raise: save your
training from time to time.
"""

from pathlib import Path
from typing import Any

import gymnasium

from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import MotorSource, simulated_motors
from motorprior.simulation.scene import Scene, WalkConfig, WalkEnv

ENV_ID = "motorprior/Walk-v0"


def make_env(
    robot: str | Path | Robot = DEFAULT_ROBOT, motors: MotorSource = "fleet", **options: Any
) -> WalkEnv:
    """Make a Gymnasium environment for policies as of `train_policy`, with new motors per episode.

    Args:
        robot: a legged robot: its name, the path of a .toml file, or a robot from `load_robot`.
        motors: motors of the episodes: a text such as "prior:FILE", "pd:kp=9" or "fleet", the
            robot's own physical motors (`actuator.registry`); a prior, a posterior or a fleet to
            sample; fixed motors; or a function that samples them with a generator.
        options: fields of `WalkConfig`, such as engine, task, randomization, commands and
            episode_steps.

    Raises:
        ConfigError: settings that do not fit together.
        ArtifactError: a file that cannot be used.
        TypeError: an unknown option.
    """
    walk = WalkConfig(**options)
    robot = walk.commands.extend_range(as_robot(robot))
    source = simulated_motors(motors, robot)
    return WalkEnv(Scene(robot, source.draw, walk, source.physics_dt))


gymnasium.register(ENV_ID, entry_point="motorprior.environments:make_env")
