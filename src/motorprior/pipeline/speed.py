"""The rollout kernel against the bare physics engine, and against slower ways."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.pipeline.motor_choice import load_robot_fleet, nominal_pd
from motorprior.pipeline.prior_file import load_prior
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.results import Results
from motorprior.robots.robot import Robot
from motorprior.simulation.timed_paths import REPEATS, compiled_paths, interpreted_paths, measure


def measure_speed(
    prior_path: Path,
    robot: Robot,
    fleet_name: str | None = None,
    interpreted: bool = False,
    progress: Progress = SILENT,
) -> Results:
    """What `simulation.timed_paths.measure` finds.

    Args:
        prior_path: of the learned motors.
        robot: a legged one.
        fleet_name: of the physical motors; the robot's own if not given.
        interpreted: measure the paths with the interpreter in the loop too.
        progress: where to report to.
    """
    prior, fleet = load_prior(prior_path, robot), load_robot_fleet(robot, fleet_name)
    learned = prior.sample(robot.num_joints, np.random.default_rng(0))
    actuators: dict[str, Actuator] = {
        "ideal_pd": nominal_pd(fleet, robot.num_joints),
        "rollout": learned,
        "physical": fleet.center(robot.num_joints).actuator(),
    }
    with progress.start("speed: episodes side by side", REPEATS) as task, ExitStack() as stack:
        paths = compiled_paths(robot, actuators) | (interpreted_paths(robot, learned) if interpreted else {})
        for path in paths.values():
            stack.callback(path.close)
        return measure(paths, progress=task.advance)
