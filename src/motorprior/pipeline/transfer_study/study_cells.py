"""The cells of a study: the policies of conditions and seeds, trained and watched; resumable per policy."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import in_parallel, threads_here
from motorprior.pipeline.transfer_study.condition import Condition
from motorprior.pipeline.transfer_study.study_settings import Study
from motorprior.pipeline.transfer_study.study_watch import twins_here, watched
from motorprior.pipeline.walking.trained_policy import policy_of
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.pipeline.walking.walk_seeds import SEEDS_APART
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.search.ars import ArsConfig
from motorprior.search.executor import many_executors
from motorprior.search.policy_search import Champion
from motorprior.search.policy_shape import PolicyShape
from motorprior.transfer.study_verdicts import UNTRAINED
from motorprior.transfer.walk_table import WalkTable

_EPISODE_STEPS = 500
"""Of every training, which is told one command."""


def walk_table(config: Study, cells: Sequence[tuple[Condition, int]], progress: Progress = SILENT) -> WalkTable:
    """Train the policies of conditions and seeds, and watch them; what is finished in ``config.out`` is read."""
    robot, twins = load_robot(config.robot), twins_here(progress)
    at_a_time = threads_here(config.workers, SILENT) if config.executor == "threads" else 1
    processes = config.workers if config.ray_address is not None else threads_here(config.workers, SILENT)
    with progress.start(f"study: {len(cells)} policies, {config.draws} walks at each place", len(cells)) as task:
        works = [partial(_cell, config, robot, twins, condition, seed, task) for condition, seed in cells]
        with many_executors(config.executor, processes, config.ray_address):
            tables = in_parallel(works, at_a_time, progress)
    return WalkTable.of(walk for each in tables for walk in each.walks)


def _cell(
    config: Study,
    robot: Robot,
    twins: tuple[str, ...],
    condition: Condition,
    seed: int,
    done: Task,
    progress: Progress,
) -> WalkTable:
    """Train the policy of a condition and a seed, and watch it everywhere."""
    name = condition.folder(seed)
    walk = Walk(
        config.out / "walk" / name, condition.motors, iterations=config.iterations, commands=config.commands(robot),
        episode_steps=_EPISODE_STEPS,
        validation=config.fleet_of_contests(robot), randomization=condition.randomization,
        search=ArsConfig(seed=SEEDS_APART * config.seed + seed), robot=config.robot,
        workers=config.episodes_at_a_time, executor=config.executor, ray_address=config.ray_address,
    )  # fmt: skip
    if condition.name == UNTRAINED:
        _gait(config.commands(robot).on(robot), condition).save(walk.out / POLICY)
    else:
        run_walk(walk, progress, name)
    table = watched(config, robot, twins, condition, seed, progress)
    done.advance(1, name)
    return table


def _gait(robot: Robot, condition: Condition) -> Policy:
    """The policy of zero weights."""
    nobody = Champion.none_yet(PolicyShape.of(robot, "trot", 0, symmetric=True))
    return policy_of(robot, "trot", nobody, condition.motors.nominal(robot), {})
