"""The rollout kernel against the bare physics engine, and against slower ways."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.physical import LONGEST_STEP, PhysicalActuator
from motorprior.pipeline.motor_choice import load_prior, load_robot_fleet, nominal_pd
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.speed import REPEATS, compiled_paths, interpreted_paths, measure


def measure_speed(
    prior_path: Path, fleet_name: str, interpreted: bool = False, progress: Progress = SILENT
) -> dict[str, float]:
    """The figures of `simulation.speed.measure`.

    Args:
        prior_path: of the learned motors.
        fleet_name: of the physical ones.
        interpreted: measure the paths with the interpreter in the loop too.
        progress: where to report to.
    """
    prior, fleet = load_prior(prior_path), load_robot_fleet(fleet_name)
    learned = prior.sample(np.random.default_rng(0), spec.NUM_JOINTS)
    actuators: dict[str, tuple[Actuator, float]] = {
        "ideal_pd": (nominal_pd(fleet, spec.NUM_JOINTS), spec.PHYSICS_DT),
        "rollout": (learned, spec.PHYSICS_DT),
        "physical": (PhysicalActuator(fleet.center(spec.NUM_JOINTS)), LONGEST_STEP),
    }
    with progress.start("speed: episodes side by side", REPEATS) as task, ExitStack() as stack:
        paths = compiled_paths(actuators) | (interpreted_paths(learned) if interpreted else {})
        for path in paths.values():
            stack.callback(path.close)
        return measure(paths, progress=task.advance)
