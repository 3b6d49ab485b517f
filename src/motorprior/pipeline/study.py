"""The transfer study: every condition, every seed, every twin; resumable per policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_tensors, write_json, write_tensors
from motorprior.exceptions import ConfigError
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.pipeline.folder_lock import taken
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.side_by_side import side_by_side, threads_here
from motorprior.pipeline.stage import description, fleet_files, is_finished, working, write_results
from motorprior.pipeline.study_conditions import Condition, adapt_robots, conditions, fleet_of, learn
from motorprior.pipeline.study_report import STUDY, TRACES, WALKS
from motorprior.pipeline.study_settings import Study
from motorprior.pipeline.time_left import TimeLeft
from motorprior.pipeline.trained_policy import policy_of
from motorprior.pipeline.transfer import own_scene
from motorprior.pipeline.walk import POLICY, Walk, run_walk
from motorprior.pipeline.walk_seeds import SEEDS_APART
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.search.ars import ArsConfig
from motorprior.search.executor import make_executor, many_executors
from motorprior.search.policy_search import Champion
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.rollout import Episode, WalkConfig
from motorprior.transfer.places import ABROAD, TWINS, NumberedWalks, OwnWalks
from motorprior.transfer.study_results import study_results
from motorprior.transfer.study_summary import Summary, summarise
from motorprior.transfer.study_verdicts import UNTRAINED
from motorprior.transfer.walk_measures import walk_measures
from motorprior.transfer.walk_table import OWN, OWN_ABROAD, WalkRow, WalkTable


def run_study(config: Study, progress: Progress = SILENT) -> Summary:
    """Run every cell that is not finished; write walks.csv, traces, results.json and figures.json.

    Raises:
        MotorPriorError: settings out of range, or a stage cannot run; what is finished stays.
    """
    config = config.sized()
    robot = load_robot(config.robot)
    with taken(config.out):
        threads = threads_here(config.workers, progress)
        learn(config, threads, progress)
        adapt_robots(config, threads, progress)
        cells = [(condition, seed) for seed in range(config.seeds) for condition in conditions(config, seed)]
        table = walk_table(config, cells, progress)
        table.save(config.out / WALKS)
        _keep_traces(config, cells)
        settings = asdict(config) | {"speed": config.told(robot)}
        write_json(config.out / STUDY, {name: str(value) for name, value in settings.items() if name != "out"})
        summary = summarise(table)
        write_results(config.out, study_results(summary))
    return summary


def walk_table(config: Study, cells: Sequence[tuple[Condition, int]], progress: Progress = SILENT) -> WalkTable:
    """Train the policies of conditions and seeds, and watch them; what is finished in ``config.out`` is read."""
    robot, twins = load_robot(config.robot), _twins_here(progress)
    at_a_time = threads_here(config.workers, SILENT) if config.executor == "threads" else 1
    processes = config.workers if config.ray_address is not None else threads_here(config.workers, SILENT)
    with progress.start(f"study: {len(cells)} policies, {config.draws} walks at each place", len(cells)) as task:
        done = _Done(task, TimeLeft(len(cells), at_a_time))
        works = [partial(_cell, config, robot, twins, condition, seed, done) for condition, seed in cells]
        with many_executors(config.executor, processes, config.ray_address):
            tables = side_by_side(works, at_a_time, progress)
    return WalkTable.of(walk for each in tables for walk in each.walks)


def _twins_here(progress: Progress) -> tuple[str, ...]:
    """Names of the twins whose engine is installed."""
    try:
        import_bullet()
    except ConfigError as error:
        progress.note(f"note: without the twin in PyBullet: {error}")
        return tuple(name for name, twin in TWINS.items() if twin.engine != "pybullet")
    return tuple(TWINS)


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
    table = _watched(config, robot, twins, condition, seed, progress)
    done.task.advance(1, f"{name}, {done.left.ended(begun)}".rstrip(", "))
    return table


def _gait(robot: Robot, condition: Condition) -> Policy:
    """The policy of zero weights."""
    nobody = Champion.none_yet(PolicyShape.of(robot, "trot", 0, symmetric=True))
    return policy_of(robot, "trot", nobody, condition.motors.nominal(robot), {})


def _watched(
    config: Study, robot: Robot, twins: tuple[str, ...], condition: Condition, seed: int, progress: Progress
) -> WalkTable:
    """The walks of a policy, measured unless they are there."""
    name = condition.folder(seed)
    folder, policy = config.out / "watched" / name, config.out / "walk" / name / POLICY
    here = tuple(twin for twin in condition.twins if twin in twins)
    settings = {
        "twins": here, "draws": config.draws, "seconds": config.seconds, "speed": config.told(robot),
        "condition": condition.name,
    }  # fmt: skip
    fleets = [file for fleet in (config.fleet, config.foreign) for file in fleet_files(robot, fleet)]
    wanted = description("study", settings | {"robot": condition.robot}, [policy, *fleets, *robot.files])
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            watch = _Watch(config, robot, condition, seed, policy, progress)
            rows, traces = watch.everywhere(here)
            WalkTable.of(rows).save(folder / WALKS)
            write_tensors(folder / TRACES, traces, {})
    return WalkTable.load(folder / WALKS)


class _Watch:
    """A policy that walks at its places."""

    def __init__(
        self, config: Study, robot: Robot, condition: Condition, seed: int, path: Path, progress: Progress
    ) -> None:
        self._config, self._condition, self._seed = config, condition, seed
        self._path, self._policy, self._progress = path, Policy.load(path), progress
        self._robot = self._policy.commanded(robot)
        self._steps = round(config.seconds / robot.control_dt)

    def everywhere(self, twins: tuple[str, ...]) -> tuple[list[WalkRow], dict[str, np.ndarray]]:
        """The walks at its own place and at the twins; the trace of the walk of median speed at each."""
        own = OWN_ABROAD if self._condition.population == ABROAD else OWN
        walk = WalkConfig(self._steps, commands=self._config.commands(self._robot), gait=self._policy.gait)
        rows, traces, places = [], {}, {}
        if self._condition.name != UNTRAINED:
            mine = replace(walk, randomization=self._condition.randomization)
            places[own] = partial(OwnWalks, own_scene(self._policy, self._path, self._robot, mine))
        for name in twins:
            twin = TWINS[name]
            fleet = load_robot_fleet(self._robot, fleet_of(self._config, twin.population))
            places[name] = partial(NumberedWalks, self._robot, twin, fleet, walk, self._condition.robot)
        for place, walks in places.items():
            found, traces[place] = self._at(place, walks)
            rows += found
        return rows, traces

    def _at(self, place: str, walks: partial[OwnWalks] | partial[NumberedWalks]) -> tuple[list[WalkRow], np.ndarray]:
        config, condition = self._config, self._condition.name
        draws = 1 if place in (OWN, OWN_ABROAD) and self._condition.one_draw_is_all else config.draws
        at_a_time, rows, traces = config.episodes_at_a_time, [], []
        executor = make_executor(walks, at_a_time, config.executor, config.ray_address)
        try:
            with self._progress.start(f"{condition} {self._seed} at {place}", draws) as task:
                for first in range(0, draws, at_a_time):
                    numbers = range(first, min(first + at_a_time, draws))
                    for draw, episode in zip(numbers, executor.map(_walk, self._policy.arrays(), numbers), strict=True):
                        measures = walk_measures(self._robot, episode, config.told(self._robot), self._steps)
                        rows.append(WalkRow(place, condition, self._seed, draw, measures))
                        traces.append(episode.trace)
                        task.advance()
        finally:
            executor.close()
        order = np.argsort([row.measures["speed"] for row in rows], kind="stable")
        return rows, traces[int(order[len(order) // 2])]


def _walk(walks: OwnWalks | NumberedWalks, policy: PolicyArrays, draw: int) -> Episode:
    return walks.run(policy, draw)


def _keep_traces(config: Study, cells: list[tuple[Condition, int]]) -> None:
    """Of the first seed, for the page."""
    robot, kept = load_robot(config.robot), {}
    for condition, seed in cells:
        if seed == 0:
            traces, _ = read_tensors(config.out / "watched" / condition.folder(seed) / TRACES)
            kept |= {f"{place}/{condition.name}": trace for place, trace in traces.items() if place != OWN_ABROAD}
    write_tensors(config.out / TRACES, kept, {"control_dt": robot.control_dt, "robot": config.robot})
