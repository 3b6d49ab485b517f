"""Where a study watches policies: twins that no policy was trained on, each unlike its training in another way.

    fleet     motors of the bench's fleet, what is not known of its center drawn once per robot
    foreign   motors of another family: other friction, hardening gear, torque-speed line with sag, heat, ripple
    hard      foreign motors; floor, load, slope, late and lost readings, late targets, pushes as in `twin.HARD`
    pybullet  the fleet's motors in the other engine: other contacts, other integration

All have the sensors of `twin.NOISY` at least. Robots are numbered: a robot's motors depend on its fleet's name, on the
study's seed and on its number alone.
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
from motorprior.simulation.engines import Engine, Scene
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import Episode, WalkConfig
from motorprior.transfer.twin import HARD, NOISY

ROBOT_STREAM = 0x20B0
"""Tag of the random stream of a numbered robot's motors, of no bench and no training."""
DRAW_STREAM = 0x20B1
"""Tag of the random stream of what else differs between walks: sensors, floor, pushes."""
HOME, ABROAD = "fleet", "foreign"
"""Names of the two populations of motors."""


@dataclass(frozen=True)
class Twin:
    """Attributes: population of its motors, HOME or ABROAD; engine; what else differs between walks."""

    population: str
    engine: Engine
    randomization: Randomization


TWINS = {
    "fleet": Twin(HOME, "mujoco", NOISY),
    "foreign": Twin(ABROAD, "mujoco", NOISY),
    "hard": Twin(ABROAD, "mujoco", HARD),
    "pybullet": Twin(HOME, "pybullet", NOISY),
}


def motors_of_robot(robot: Robot, fleet: Fleet, study: int, number: int) -> TrueMotors:
    """The motors of robot ``number`` of the study with seed ``study``: of one robot, see `Fleet.sample`.

    Robots of two fleets share nothing: fleets of one motor draw the same parameters in the same order.
    """
    stream = [ROBOT_STREAM, study, number, crc32(fleet.name.encode())]
    return fleet.sample(robot.num_joints, np.random.default_rng(stream), of_one_robot=True)


def walk_seed(study: int, draw: int) -> int:
    """Seed of the sensors, floor and pushes of walk ``draw`` of the study with seed ``study``."""
    return seed_of(DRAW_STREAM, study, draw)


class NumberedWalks:
    """Walks on numbered robots of a twin.

    Args:
        robot: that walks.
        twin: one of TWINS.
        fleet: of its motors.
        walk: episode; its randomization is the twin's.
        study: seed of the study.
        only: number of the one robot that walks all draws; by default draw d walks on robot d.
    """

    def __init__(self, robot: Robot, twin: Twin, fleet: Fleet, walk: WalkConfig, study: int, only: int | None = None):
        self._study, self._number, self._only = study, 0, only
        walk = replace(walk, randomization=twin.randomization)

        def draw(_: np.random.Generator) -> Actuator:
            return motors_of_robot(robot, fleet, study, self._number).actuator()

        self._simulator = Scene(robot, twin.engine, draw, robot.twin_physics_dt, walk).simulator()

    def run(self, policy: PolicyArrays, draw: int) -> Episode:
        """Walk ``draw`` of a policy, with its trace."""
        self._number = draw if self._only is None else self._only
        return self._simulator.run(policy, walk_seed(self._study, draw), trace=True)

    def close(self) -> None:
        """Close the engine."""
        self._simulator.close()


class OwnWalks:
    """Walks in the simulation that a policy was trained in, on draws that its training did not have."""

    def __init__(self, scene: Scene, study: int):
        self._study, self._simulator = study, scene.simulator()

    def run(self, policy: PolicyArrays, draw: int) -> Episode:
        """See `NumberedWalks.run`."""
        return self._simulator.run(policy, walk_seed(self._study, draw), trace=True)

    def close(self) -> None:
        """Close the engine."""
        self._simulator.close()
