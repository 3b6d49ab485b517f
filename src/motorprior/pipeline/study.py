"""The transfer study: every condition, every seed, every twin; resumable per policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

from motorprior.artifacts import read_tensors, write_json, write_tensors
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.folder_lock import taken
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.side_by_side import side_by_side, threads_here
from motorprior.pipeline.stage import write_results
from motorprior.pipeline.study_conditions import Condition, adapt_robots, conditions, learn
from motorprior.pipeline.study_report import STUDY, TRACES, WALKS
from motorprior.pipeline.study_settings import Study
from motorprior.pipeline.study_watch import twins_here, watched
from motorprior.pipeline.time_left import TimeLeft
from motorprior.pipeline.trained_policy import policy_of
from motorprior.pipeline.walk import POLICY, Walk, run_walk
from motorprior.pipeline.walk_seeds import SEEDS_APART
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.search.ars import ArsConfig
from motorprior.search.executor import many_executors
from motorprior.search.policy_search import Champion
from motorprior.search.policy_shape import PolicyShape
from motorprior.transfer.study_results import study_results
from motorprior.transfer.study_summary import Summary, summarise
from motorprior.transfer.study_verdicts import UNTRAINED
from motorprior.transfer.walk_table import OWN_ABROAD, WalkTable


def run_study(config: Study, progress: Progress = SILENT) -> Summary:
    """Run every cell that is not finished; write walks.csv, traces, results.json and figures.json.

    Raises:
        MotorPriorError: settings out of range, or a stage cannot run; what is finished stays.
    """
    config = config.sized()
    robot = load_robot(config.robot)
    with taken(config.out):
        threads = threads_here(config.workers, progress)
        if config.ray_address is None:  # told once, not at every policy
            config = replace(config, workers=threads)
        learn(config, threads, progress)
        adapt_robots(config, threads, progress)
        cells = [(condition, seed) for seed in range(config.seeds) for condition in conditions(config, seed)]
        table = walk_table(config, cells, progress)
        table.save(config.out / WALKS)
        _keep_traces(config, cells)
        settings = asdict(config) | {"speed": config.told(robot)}
        for where in ("out", "workers", "executor", "ray_address"):  # the result does not depend on them
            del settings[where]
        write_json(config.out / STUDY, {name: str(value) for name, value in settings.items()})
        summary = summarise(table)
        write_results(config.out, study_results(summary))
    return summary


def walk_table(config: Study, cells: Sequence[tuple[Condition, int]], progress: Progress = SILENT) -> WalkTable:
    """Train the policies of conditions and seeds, and watch them; what is finished in ``config.out`` is read."""
    robot, twins = load_robot(config.robot), twins_here(progress)
    at_a_time = threads_here(config.workers, SILENT) if config.executor == "threads" else 1
    processes = config.workers if config.ray_address is not None else threads_here(config.workers, SILENT)
    with progress.start(f"study: {len(cells)} policies, {config.draws} walks at each place", len(cells)) as task:
        done = _Done(task, TimeLeft(len(cells), at_a_time))
        works = [partial(_cell, config, robot, twins, condition, seed, done) for condition, seed in cells]
        with many_executors(config.executor, processes, config.ray_address):
            tables = side_by_side(works, at_a_time, progress)
    return WalkTable.of(walk for each in tables for walk in each.walks)


@dataclass(frozen=True)
class _Done:
    """What counts the policies that are done, and says how long the others take."""

    task: Task
    left: TimeLeft


def _cell(
    config: Study,
    robot: Robot,
    twins: tuple[str, ...],
    condition: Condition,
    seed: int,
    done: _Done,
    progress: Progress,
) -> WalkTable:
    """Train the policy of a condition and a seed, and watch it everywhere."""
    name, begun = condition.folder(seed), done.left.begun()
    walk = Walk(
        config.out / "walk" / name, condition.motors, iterations=config.iterations, commands=config.commands(robot),
        validation=config.validation, randomization=condition.randomization,
        search=ArsConfig(seed=SEEDS_APART * config.seed + seed), robot=config.robot,
        workers=config.episodes_at_a_time, executor=config.executor, ray_address=config.ray_address,
    )  # fmt: skip
    if condition.name == UNTRAINED:
        _gait(config.commands(robot).on(robot), condition).save(walk.out / POLICY)
    else:
        run_walk(walk, progress, name)
    table = watched(config, robot, twins, condition, seed, progress)
    done.task.advance(1, f"{name}, {done.left.ended(begun)}".rstrip(", "))
    return table


def _gait(robot: Robot, condition: Condition) -> Policy:
    """The policy of zero weights."""
    nobody = Champion.none_yet(PolicyShape.of(robot, "trot", 0, symmetric=True))
    return policy_of(robot, "trot", nobody, condition.motors.nominal(robot), {})


def _keep_traces(config: Study, cells: list[tuple[Condition, int]]) -> None:
    """Of the first seed, for the page."""
    robot, kept = load_robot(config.robot), {}
    for condition, seed in cells:
        if seed == 0:
            traces, _ = read_tensors(config.out / "watched" / condition.folder(seed) / TRACES)
            kept |= {f"{place}/{condition.name}": trace for place, trace in traces.items() if place != OWN_ABROAD}
    write_tensors(config.out / TRACES, kept, {"control_dt": robot.control_dt, "robot": config.robot})
