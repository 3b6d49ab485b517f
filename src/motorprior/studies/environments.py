"""Test environments of a study; no policy was trained in them.

    fleet     motors of the bench's fleet, with one offset of all its motors per robot
    foreign   out-of-family motors: other friction, hardening gear, torque-speed line with sag, heat, ripple
    hard      out-of-family motors; floor, load, slope, delays, dropped readings and pushes as in `twin.HARD`
    pybullet  the bench's fleet in the other engine: other contacts, other integration

All have at least the sensor noise of `twin.NOISY`. Robots are numbered: a robot's motors depend on its fleet's name,
the study's seed and its number alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.families import TrueMotors
from motorprior.bench.fleet import Fleet
from motorprior.bounds import seed_of
from motorprior.locomotion.policy import PolicyArrays
from motorprior.robots.robot import Robot
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import Episode
from motorprior.simulation.scene import Engine, Scene, WalkConfig
from motorprior.studies.twin import HARD, NOISY

ROBOT_STREAM = 0x20B0  # random stream of a robot's motors, of no bench and no training
DRAW_STREAM = 0x20B1  # random stream of sensors, floor and pushes
IN_FAMILY, OUT_OF_FAMILY = "fleet", "foreign"  # populations of motors


@dataclass(frozen=True)
class Environment:
    """Attributes: population of its motors; engine; randomization between walks."""

    population: str
    engine: Engine
    randomization: Randomization


ENVIRONMENTS = {
    "fleet": Environment(IN_FAMILY, "mujoco", NOISY),
    "foreign": Environment(OUT_OF_FAMILY, "mujoco", NOISY),
    "hard": Environment(OUT_OF_FAMILY, "mujoco", HARD),
    "pybullet": Environment(IN_FAMILY, "pybullet", NOISY),
}


def motors_of_robot(robot: Robot, fleet: Fleet, study: int, number: int) -> TrueMotors:
    """Motors of robot ``number`` of the study with seed ``study``, see `Fleet.sample`."""
    # with the name: fleets of one motor family would draw the same parameters in the same order
    stream = [ROBOT_STREAM, study, number, crc32(fleet.name.encode())]
    return fleet.sample(robot.num_joints, np.random.default_rng(stream), of_one_robot=True)


def walk_seed(study: int, draw: int) -> int:
    """Seed of the sensors, floor and pushes of walk ``draw`` of the study with seed ``study``."""
    return seed_of(DRAW_STREAM, study, draw)


class TrainingWalks:
    """Walks in a policy's training simulation, with samples that its training did not use."""

    def __init__(self, scene: Scene, study: int):
        self._study, self._simulator = study, scene.simulator()

    def run(self, policy: PolicyArrays, draw: int) -> Episode:
        """Walk ``draw`` of a policy, with its trace."""
        return self._simulator.run(policy, walk_seed(self._study, draw), trace=True)

    def close(self) -> None:
        """Close the engine."""
        self._simulator.close()


class HeldOutWalks(TrainingWalks):
    """Walks on numbered robots in an environment.

    Args:
        robot: description of the robot.
        environment: one of ENVIRONMENTS.
        fleet: of its motors.
        walk: episode; its randomization is replaced by the environment's.
        study: seed of the study.
        only: number of the robot for all walks; if not given, walk d uses robot d.
    """

    def __init__(
        self,
        robot: Robot,
        environment: Environment,
        fleet: Fleet,
        walk: WalkConfig,
        study: int,
        only: int | None = None,
    ):
        self._number, self._only = 0, only
        walk = replace(walk, randomization=environment.randomization, engine=environment.engine)

        def sample(_: np.random.Generator) -> Actuator:
            return motors_of_robot(robot, fleet, study, self._number).actuator()

        super().__init__(Scene(robot, sample, walk, robot.twin_physics_dt), study)

    def run(self, policy: PolicyArrays, draw: int) -> Episode:
        """Walk ``draw`` of a policy, with its trace."""
        self._number = draw if self._only is None else self._only
        return super().run(policy, draw)
