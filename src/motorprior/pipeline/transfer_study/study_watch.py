"""Policies of a study walk at their places: the walks of each, kept as they are finished."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.exceptions import ConfigError
from motorprior.locomotion.policy import Policy, PolicyArrays
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.stage import description, fleet_files, is_finished, working
from motorprior.pipeline.transfer_study.condition import Condition, fleet_of
from motorprior.pipeline.transfer_study.study_report import TRACES, WALKS
from motorprior.pipeline.transfer_study.study_settings import Study
from motorprior.pipeline.transfer_study.transfer import own_scene
from motorprior.pipeline.walking.walk import POLICY
from motorprior.robots.robot import Robot
from motorprior.search.executor import Executor, make_executor
from motorprior.search.executor_process import ProcessExecutor
from motorprior.simulation.bullet_world import import_bullet
from motorprior.simulation.rollout import Episode, WalkConfig
from motorprior.transfer.places import ABROAD, TWINS, NumberedWalks, OwnWalks
from motorprior.transfer.study_verdicts import UNTRAINED
from motorprior.transfer.walk_measures import walk_measures
from motorprior.transfer.walk_table import OWN, OWN_ABROAD, WalkRow, WalkTable


def twins_here(progress: Progress) -> tuple[str, ...]:
    """Names of the twins whose engine is installed."""
    try:
        import_bullet()
    except ConfigError as error:
        progress.note(f"note: without the twin in PyBullet: {error}")
        return tuple(name for name, twin in TWINS.items() if twin.engine != "pybullet")
    return tuple(TWINS)


def watched(
    config: Study, robot: Robot, twins: tuple[str, ...], condition: Condition, seed: int, progress: Progress
) -> WalkTable:
    """The walks of the policy in ``config.out``/walk, measured unless they are there.

    Args:
        config: of the study.
        robot: as it is built.
        twins: whose engine is installed, see `twins_here`.
        condition: what the policy was trained on.
        seed: of its training.
        progress: where to report to.

    Raises:
        ArtifactError: no such policy, or a file that cannot be read.
    """
    name = condition.folder(seed)
    folder, policy = config.out / "watched" / name, config.out / "walk" / name / POLICY
    here = tuple(twin for twin in condition.twins if twin in twins)
    settings = {
        "twins": here, "draws": config.draws, "seconds": config.seconds, "speed": config.told(robot),
        "study": config.seed, "condition": condition.name, "one_draw_is_all": condition.one_draw_is_all,
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
        rows, traces, places, study = [], {}, {}, self._config.seed
        if self._condition.name != UNTRAINED:
            mine = replace(walk, randomization=self._condition.randomization)
            places[own] = partial(OwnWalks, own_scene(self._policy, self._path, self._robot, mine), study)
        for name in twins:
            twin = TWINS[name]
            fleet = load_robot_fleet(self._robot, fleet_of(self._config, twin.population))
            places[name] = partial(NumberedWalks, self._robot, twin, fleet, walk, study, self._condition.robot)
        for place, walks in places.items():
            found, traces[place] = self._at(place, walks)
            rows += found
        return rows, traces

    def _at(self, place: str, walks: partial[OwnWalks] | partial[NumberedWalks]) -> tuple[list[WalkRow], np.ndarray]:
        config, condition = self._config, self._condition.name
        draws = 1 if place in (OWN, OWN_ABROAD) and self._condition.one_draw_is_all else config.draws
        at_a_time, rows, traces = config.episodes_at_a_time, [], []
        executor = self._executor(place, walks)
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

    def _executor(self, place: str, walks: partial[OwnWalks] | partial[NumberedWalks]) -> Executor:
        """PyBullet holds the interpreter lock, and would have policies wait for each other."""
        config = self._config
        if config.executor != "ray" and place in TWINS and TWINS[place].engine == "pybullet":
            return ProcessExecutor(walks, config.episodes_at_a_time)
        return make_executor(walks, config.episodes_at_a_time, config.executor, config.ray_address)


def _walk(walks: OwnWalks | NumberedWalks, policy: PolicyArrays, draw: int) -> Episode:
    return walks.run(policy, draw)
