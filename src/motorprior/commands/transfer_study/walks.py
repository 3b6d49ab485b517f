"""Train the policy of a condition and seed, and evaluate it in its training simulation and the test environments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from motorprior.bench.fleet import fleet_files, load_robot_fleet
from motorprior.commands.transfer_study.conditions import Condition, fleet_of
from motorprior.commands.transfer_study.settings import Study
from motorprior.commands.transfer_study.walk_table import OWN, OWN_FOREIGN, WalkRow, WalkTable
from motorprior.commands.walk import POLICY, Walk, run_walk
from motorprior.commands.walk_seeds import SEEDS_APART
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import Executor, make_executor, shared_cluster
from motorprior.locomotion.executor_process import ProcessExecutor
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.locomotion.policy_search import BestPolicy
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.progress import SILENT, Progress, Task
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.rollout import Episode, WalkConfig
from motorprior.simulation.training import policy_of
from motorprior.stage import description, in_parallel, is_finished, usable_threads, working
from motorprior.studies.environments import ENVIRONMENTS, OUT_OF_FAMILY, HeldOutWalks, TrainingWalks
from motorprior.studies.training_scene import training_scene
from motorprior.studies.walk_measures import walk_measures

WALKS = "walks.csv"
_EPISODE_STEPS = 500  # of training


def walk_table(config: Study, cells: Sequence[tuple[Condition, int]], progress: Progress = SILENT) -> WalkTable:
    """Train and evaluate policies; finished ones in ``config.out`` are read."""
    robot, environments = load_robot(config.robot), _installed_environments(progress)
    at_a_time = usable_threads(config.workers, SILENT) if config.executor == "threads" else 1
    processes = config.workers if config.ray_address is not None else usable_threads(config.workers, SILENT)
    name = f"study: {len(cells)} policies, {config.draws} walks per environment"
    with progress.start(name, len(cells)) as task, shared_cluster(config.executor, processes, config.ray_address):
        works = [partial(_cell, config, robot, environments, *cell, task) for cell in cells]
        tables = in_parallel(works, at_a_time, progress)
    return WalkTable.of(walk for each in tables for walk in each.walks)


def _installed_environments(progress: Progress) -> tuple[str, ...]:
    try:
        import_bullet()
    except ConfigError as error:
        progress.note(f"note: skipped the environment pybullet: {error}")
        return tuple(name for name, twin in ENVIRONMENTS.items() if twin.engine != "pybullet")
    return tuple(ENVIRONMENTS)


def _cell(
    config: Study,
    robot: Robot,
    environments: tuple[str, ...],
    condition: Condition,
    seed: int,
    task: Task,
    progress: Progress,
) -> WalkTable:
    """Train and evaluate one policy."""
    name = condition.folder(seed)
    walk = Walk(
        config.out / "walk" / name, condition.motors, iterations=config.iterations, commands=config.commands(robot),
        episode_steps=_EPISODE_STEPS, validation=config.validation_fleet(robot),
        randomization=condition.randomization, search=ArsConfig(seed=SEEDS_APART * config.seed + seed),
        robot=config.robot, workers=config.episodes_at_a_time, executor=config.executor,
        ray_address=config.ray_address,
    )  # fmt: skip
    if condition.name == "untrained":
        _untrained_policy(config.commands(robot).extend_range(robot), condition).save(walk.out / POLICY)
    else:
        run_walk(walk, progress, name)
    tested = tuple(each for each in condition.environments if each in environments)
    settings = {
        "twins": tested, "draws": config.draws, "seconds": config.seconds, "speed": config.commanded(robot),
        "study": config.seed, "condition": condition.name, "robot": condition.robot,
    }  # fmt: skip
    fleets = [file for fleet in (config.fleet, config.foreign) for file in fleet_files(robot, fleet)]
    wanted = description("study", settings, [walk.out / POLICY, *fleets, *robot.files])
    folder = config.out / "watched" / name
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            evaluated(config, robot, condition, seed, tested, progress).save(folder / WALKS)
    task.advance(1, name)
    return WalkTable.load(folder / WALKS)


def _untrained_policy(robot: Robot, condition: Condition) -> Policy:
    """The policy of zero weights."""
    zero = BestPolicy.none_yet(PolicyShape.of(robot, "trot", 0, symmetric=True))
    return policy_of(robot, "trot", zero, simulated_motors(condition.motors, robot).nominal, {})


def evaluated(
    config: Study, robot: Robot, condition: Condition, seed: int, environments: tuple[str, ...], progress: Progress
) -> WalkTable:
    """Walks of a trained policy in its training simulation and in environments."""
    path = config.out / "walk" / condition.folder(seed) / POLICY
    policy = Policy.load(path)
    robot = robot.with_speed_range(policy.forward)
    steps = round(config.seconds / robot.control_dt)
    walk = WalkConfig(steps, commands=config.commands(robot), gait=policy.gait)
    places: dict[str, partial[TrainingWalks] | partial[HeldOutWalks]] = {}
    if condition.name != "untrained":
        scene = training_scene(policy, path, robot, replace(walk, randomization=condition.randomization))
        own = OWN_FOREIGN if condition.population == OUT_OF_FAMILY else OWN
        places[own] = partial(TrainingWalks, scene, config.seed)
    for name in environments:
        fleet = load_robot_fleet(robot, fleet_of(config, ENVIRONMENTS[name].population))
        places[name] = partial(HeldOutWalks, robot, ENVIRONMENTS[name], fleet, walk, config.seed, condition.robot)
    rows = []
    for place, walks in places.items():
        once = place in (OWN, OWN_FOREIGN) and condition.is_deterministic(robot)
        draws, at_a_time = 1 if once else config.draws, config.episodes_at_a_time
        executor = _executor(config, place, walks)
        try:
            with progress.start(f"{condition.name} {seed}: {place}", draws) as task:
                for first in range(0, draws, at_a_time):
                    numbers = range(first, min(first + at_a_time, draws))
                    for draw, episode in zip(numbers, executor.map(_walk, policy.arrays(), numbers), strict=True):
                        measures = walk_measures(robot, episode, config.commanded(robot), steps)
                        rows.append(WalkRow(place, condition.name, seed, draw, measures))
                        task.advance()
        finally:
            executor.close()
    return WalkTable.of(rows)


def _executor(config: Study, place: str, walks: partial[TrainingWalks] | partial[HeldOutWalks]) -> Executor:
    if config.executor != "ray" and place in ENVIRONMENTS and ENVIRONMENTS[place].engine == "pybullet":
        return ProcessExecutor(walks, config.episodes_at_a_time)  # PyBullet holds the interpreter's lock
    return make_executor(walks, config.episodes_at_a_time, config.executor, config.ray_address)


def _walk(walks: TrainingWalks | HeldOutWalks, policy: PolicyArrays, draw: int) -> Episode:
    return walks.run(policy, draw)
