"""The twin: a held-out virtual robot with held-out physical motors, 1 kHz physics and noisy encoders."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.fleet import Fleet
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.task import TaskWeights
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world_config import WorldConfig

TWIN_STREAM = 0x7717
"""Tag of the random stream of the twin's motors, used by no bench and no training episode."""
ENCODER_NOISE = 0.001
"""Standard deviation of the twin's joint angle readings [rad]; assumption, 50 counts of the rotor's encoder."""
NOISY = Randomization(joint_noise=ENCODER_NOISE, tilt_noise=0.002, rate_noise=0.01, gyro_bias=0.002)
"""What the twin's sensors do to a policy that follows commands. White noise is assumed for a MEMS sensor at 100 Hz; a
constant error of 0.1 °/s is left of a consumer gyroscope's after it was averaged at rest."""
HARD = replace(
    NOISY,
    friction=(0.7, 1.3),
    mass=(0.9, 1.1),
    com=0.01,
    gravity_tilt=0.03,
    sensor_delay=(0.0, 0.02),
    sensor_jitter=0.005,
    command_jitter=0.005,
    dropped=0.02,
    push=0.3,
    push_interval=2.0,
)
"""A twin on unknown ground with an unknown load. Masses and lateness are within what Tan et al. 2018 (RSS,
"Sim-to-Real: Learning Agile Locomotion For Quadruped Robots", table of randomised parameters) train on: ×0.8-1.2 and
0-40 ms. The others are assumptions: a floor more slippery than theirs (the robot's feet have 0.45, theirs 0.5-1.25), a
load off its place, slopes of a floor at home, a loop on a busy computer, pushes of a hand that change the speed of its
2.1 kg by up to 0.14 m/s."""
DURATION_STEPS = 500
"""Control steps of a walk of 5 s."""


def draw_twin_motors(robot: Robot, fleet: Fleet, rng: np.random.Generator) -> Actuator:
    """The motors of one twin; what is not known of the fleet's center is the same for all of them."""
    own = np.random.default_rng([TWIN_STREAM, *rng.integers(2**32, size=2)])
    return fleet.sample(robot.num_joints, own, of_one_robot=True).actuator()


def together(robot: Robot, policies: Iterable[Policy]) -> Robot:
    """The robot, told the speeds that all of these policies may be told."""
    ranges = [policy.forward for policy in policies]
    return robot.told((max(low for low, _ in ranges), min(high for _, high in ranges)))


def straight_ahead(robot: Robot) -> Commands:
    """As fast as the robot is told at most: of a policy's robot, what the policy was trained for."""
    return Commands.steady(robot.require_legs().forward[1])


def twin_simulator(
    robot: Robot, fleet: Fleet, gait: GaitName = "trot", commands: Commands | None = None
) -> WalkSimulator:
    """A simulator whose every episode is another twin of this fleet, told to walk `straight_ahead` if not other."""
    noise = Randomization(joint_noise=ENCODER_NOISE)
    return twin_of(
        robot, fleet, WalkConfig(DURATION_STEPS, TaskWeights(), noise, commands or straight_ahead(robot), gait)
    )


def twin_of(robot: Robot, fleet: Fleet, walk: WalkConfig) -> WalkSimulator:
    """A simulator whose every episode is another twin of this fleet."""
    world = WorldConfig.of(robot, physics_dt=robot.twin_physics_dt)
    return WalkSimulator(lambda rng: draw_twin_motors(robot, fleet, rng), world, walk)
