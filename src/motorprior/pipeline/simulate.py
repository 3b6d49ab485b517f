"""Position targets in, joint angles and torques out: a robot on given motors, without a policy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.bounds import generator_of, require_finite
from motorprior.pipeline.motor_choice import MotorSource, drawn_from
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.replay import Replay, replay
from motorprior.simulation.world import World, WorldConfig


def simulate(
    robot: Robot | str | Path,
    motors: MotorSource,
    targets: np.ndarray,
    *,
    seed: int | np.random.Generator = 0,
    hung: bool = False,
) -> Replay:
    """Hold each row of ``targets`` for one control step of the robot, from rest in its nominal pose.

    Args:
        robot: a name, the path of a .toml file, or what `load_robot` gave; with legs or without.
        motors: one per joint, or a prior, posterior or fleet to draw them from.
        targets: (C, joints) position targets [rad], in the order of ``robot.joint_names``.
        seed: of the draw, where ``motors`` is something to draw from.
        hung: hold a free base in the air.

    Returns:
        Angles [rad] and torques [N·m] of every physics step, encoders and base of every control step.

    Raises:
        ConfigError: motors or targets that do not fit the robot.
        ArtifactError: a robot that cannot be read.
        SimulationFault: the simulation broke down.
    """
    robot = as_robot(robot)
    draw, physics_dt = drawn_from(motors, robot)
    wanted = require_finite("targets", targets, (len(targets), robot.num_joints))
    world = World(WorldConfig.of(robot, physics_dt=physics_dt, hung=hung))
    return replay(world, draw(generator_of(seed)), wanted)
