"""Environments in which policies are evaluated; no policy was trained in them.

The *twin* is a held-out virtual robot: unseen motors of a fleet, 1 kHz physics, sensor noise. The
test environments of a study are twins, too, with numbered robots: a robot's motors depend on its
fleet's name, the study's seed and its number alone.

    fleet               motors of the bench's fleet, with one offset of all its motors per robot
    hard                the same motors; floor, load, slope, delays, dropped readings and pushes as
                        in HARD
    out_of_family       out-of-family motors: other friction, hardening gear, torque-speed line
                        with sag, heat, ripple
    hard_out_of_family  out-of-family motors with the disturbances of `hard`
    pybullet            the bench's fleet in the other engine: other contacts, other integration

All have at least the sensor noise of NOISY.
"""

from dataclasses import dataclass, replace
from functools import partial
from zlib import crc32

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.families import TrueMotors
from motorprior.actuator.fleet import Fleet
from motorprior.bounds import seed_of
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import Engine, Scene, WalkConfig

# random streams, used by no bench and no training
TWIN_STREAM = 0x7717  # of the twin's motors
ROBOT_STREAM = 0x20B0  # of a numbered robot's motors
WALK_STREAM = 0x20B1  # of a study's sensors, floor and pushes

ENCODER_NOISE = 0.001  # [rad] standard deviation; assumption, 50 counts of the rotor's encoder

# populations of motors
IN_FAMILY = "fleet"
OUT_OF_FAMILY = "out_of_family"

# Assumed sensors of the twin: white noise of a MEMS sensor at 100 Hz; bias of a gyroscope averaged
# at rest, 0.1 °/s.
NOISY = Randomization(joint_noise=ENCODER_NOISE, tilt_noise=0.002, rate_noise=0.01, gyro_bias=0.002)
# Unknown ground and load. Masses and delays are within Tan et al. 2018 (RSS, "Sim-to-Real: Learning
# Agile Locomotion For Quadruped Robots", table of randomised parameters): ×0.8-1.2 and 0-40 ms.
# Assumptions: friction, an off-centre load, sloping floors, jitter of a busy computer, and pushes
# that change the speed of 2.1 kg by up to 0.14 m/s.
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


@dataclass(frozen=True)
class Environment:
    """A test environment."""

    population: str  # population of the motors
    engine: Engine
    randomization: Randomization  # between walks


ENVIRONMENTS = {
    "fleet": Environment(IN_FAMILY, "mujoco", NOISY),
    "hard": Environment(IN_FAMILY, "mujoco", HARD),
    "out_of_family": Environment(OUT_OF_FAMILY, "mujoco", NOISY),
    "hard_out_of_family": Environment(OUT_OF_FAMILY, "mujoco", HARD),
    "pybullet": Environment(IN_FAMILY, "pybullet", NOISY),
}


def held_out_scene(robot: Robot, fleet: Fleet, walk: WalkConfig) -> Scene:
    """The simulation of a twin, with other motors of the fleet in every walk."""
    return Scene(robot, partial(_twin_motors, robot, fleet), walk, robot.twin_physics_dt)


def _twin_motors(robot: Robot, fleet: Fleet, rng: np.random.Generator) -> Actuator:
    twin_rng = np.random.default_rng([TWIN_STREAM, *rng.integers(2**32, size=2)])
    return fleet.sample(robot.num_joints, twin_rng, of_one_robot=True).actuator()


def motors_of_robot(robot: Robot, fleet: Fleet, study_seed: int, number: int) -> TrueMotors:
    """Motors of robot ``number`` of the study with seed ``study_seed``, see `Fleet.sample`."""
    # with the name: fleets of one motor family would sample the same parameters in the same order
    stream = [ROBOT_STREAM, study_seed, number, crc32(fleet.name.encode())]
    return fleet.sample(robot.num_joints, np.random.default_rng(stream), of_one_robot=True)


def motors_of_walk(
    robot: Robot, fleet: Fleet, study_seed: int, only: int | None, number: int
) -> Actuator:
    """Motors of walk ``number`` of a study: the motors of a numbered robot.

    The robot has the number ``only`` or, if that is None, the number of the walk.
    """
    robot_number = number if only is None else only
    return motors_of_robot(robot, fleet, study_seed, robot_number).actuator()


def walk_seed(study_seed: int, number: int) -> int:
    """Seed of the sensors, floor and pushes of walk ``number`` of a study with this seed."""
    return seed_of(WALK_STREAM, study_seed, number)
