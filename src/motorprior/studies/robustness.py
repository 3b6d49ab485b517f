"""Maps of the time upright over pushes and friction of the floor, on held-out motors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from motorprior.bench.fleet import Fleet
from motorprior.locomotion.command import Commands
from motorprior.simulation.scene import WalkConfig
from motorprior.studies.compare import TrainedPolicy, run_walks
from motorprior.studies.environments import NOISY, motors_of_walk, twin_scene, walk_seed
from motorprior.studies.gait_quality import share_upright

PUSHES = (0.0, 0.3, 0.6, 0.9)  # largest impulse, every second [N·s]
FRICTIONS = (0.5, 0.75, 1.0, 1.25)  # factor on the friction of the feet
_ROBOTS, _STEPS = 4, 500


def robustness_map(policies: Sequence[TrainedPolicy], fleet: Fleet, commands: Commands, study: int) -> np.ndarray:
    """(pushes, frictions) mean time upright [-] of policies in walks of 5 s, each on the same robots of a fleet.

    Args:
        policies: of one robot.
        fleet: of the robots' motors.
        commands: of every walk.
        study: seed of the study, which numbers the robots, see `motors_of_robot`.
    """
    found = np.zeros((len(PUSHES), len(FRICTIONS)))
    for trained in policies:
        walk = WalkConfig(_STEPS, commands=commands, gait=trained.policy.gait)
        motors = partial(motors_of_walk, trained.robot, fleet, study, None)
        for row, push in enumerate(PUSHES):
            for column, friction in enumerate(FRICTIONS):
                around = replace(NOISY, push=push, friction=(friction, friction))
                scene = twin_scene(trained.robot, fleet, replace(walk, randomization=around))
                episodes = run_walks(scene, trained.policy.arrays, range(_ROBOTS), partial(walk_seed, study), motors)
                found[row, column] += np.mean([share_upright(episode, _STEPS) for episode in episodes])
    return found / len(policies)
