"""Transfer study: a policy walks in the simulation it was trained in, and on the twin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from motorprior.locomotion.policy import Policy
from motorprior.robots.robot import Robot
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.rollout import Episode, WalkSimulator
from motorprior.transfer.gait_quality import lasted
from motorprior.transfer.twin import DURATION_STEPS

DRAWS = 24
STUDY_SEED = 90_000_000
"""First seed of the study's episodes; those of trainings are hashes, which are hardly ever among so few."""


@dataclass(frozen=True)
class Walking:
    """Means over DRAWS draws of motors, each walking for 5 s.

    Attributes:
        speed: forward displacement divided by 5 s, also after an earlier fall [m/s].
        upright: share of the 5 s before a fall [-].
        drift: |sideways displacement| at the end [m].
    """

    speed: float
    upright: float
    drift: float


def evaluate(
    robot: Robot,
    policy: Policy,
    simulator: WalkSimulator | BackendSimulator,
    progress: Callable[[], None] | None = None,
) -> tuple[Walking, np.ndarray]:
    """Walk on DRAWS draws of motors.

    Args:
        robot: the robot that walks.
        policy: the policy.
        simulator: simulator whose episodes last DURATION_STEPS.
        progress: called after every episode.

    Returns:
        The figures, and the (steps, 7 + joints) trace of the draw with the median distance.
    """
    episodes = []
    for draw in range(DRAWS):
        episodes.append(_walk(policy, simulator, draw))
        if progress is not None:
            progress()
    order = np.argsort([episode.displacement[0] for episode in episodes], kind="stable")
    return _summary(episodes, robot.control_dt), episodes[int(order[len(order) // 2])].trace


def _walk(policy: Policy, simulator: WalkSimulator | BackendSimulator, draw: int) -> Episode:
    return simulator.run(policy.arrays(), STUDY_SEED + draw, trace=True)


def _summary(episodes: list[Episode], control_dt: float) -> Walking:
    duration = DURATION_STEPS * control_dt
    forward = np.mean([episode.displacement[0] for episode in episodes])
    drift = np.mean([abs(episode.displacement[1]) for episode in episodes])
    upright = np.mean([share_upright(episode, DURATION_STEPS) for episode in episodes])
    return Walking(float(forward / duration), float(upright), float(drift))


def share_upright(episode: Episode, steps: int) -> float:
    """Share of an episode of so many control steps before a fall or a breakdown of the physics [-]."""
    return (episode.steps - (not lasted(episode, steps))) / steps
