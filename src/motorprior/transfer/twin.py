"""The twin: a held-out virtual robot with held-out physical motors, 1 kHz physics and noisy encoders."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.fleet import Fleet
from motorprior.locomotion.task import TaskWeights
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world import WorldConfig

TWIN_STREAM = 0x7717
"""Tag of the random stream of the twin's motors, used by no bench and no training episode."""
ENCODER_NOISE = 0.001
"""Standard deviation of the twin's joint angle readings [rad]; assumption, 50 counts of the rotor's encoder."""
DURATION_STEPS = 500
"""Control steps of a walk of 5 s."""


def draw_twin_motors(robot: Robot, fleet: Fleet, rng: np.random.Generator) -> Actuator:
    """The motors of one twin."""
    own = np.random.default_rng([TWIN_STREAM, *rng.integers(2**32, size=2)])
    return fleet.sample(robot.num_joints, own).actuator()


def twin_simulator(robot: Robot, fleet: Fleet) -> WalkSimulator:
    """A simulator whose every episode is another twin of this fleet."""
    world = WorldConfig.of(robot, physics_dt=robot.twin_physics_dt)
    walk = WalkConfig(DURATION_STEPS, TaskWeights(), Randomization(joint_noise=ENCODER_NOISE))
    return WalkSimulator(lambda rng: draw_twin_motors(robot, fleet, rng), world, walk)
