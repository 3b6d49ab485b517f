"""Evaluate policies in their training simulation and on the twin."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.bench.fleet import Fleet, fleet_files, load_robot_fleet
from motorprior.bounds import require_count
from motorprior.commands.walk import POLICY
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress, in_parallel, usable_threads
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.engines import Engine
from motorprior.stage import description, is_finished, read_results, working, write_results
from motorprior.studies import twin
from motorprior.studies.training_scene import TrainedWalk, trained_walk

TRACES = "traces.safetensors"


@dataclass(frozen=True)
class Transfer:
    """Evaluate policies in their training simulation and on the twin: unseen motors, 1 kHz, encoder noise."""

    walks: tuple[Path, ...]
    """Folders of `motorprior walk`; seeds of one actuator model are averaged."""
    out: Path
    """Folder for figures.json and the traces of the report."""
    fleet: str | None = None
    """The twin's fleet; the robot's own if not given."""
    engine: Engine | None = None
    """Engine of the training simulation; the one of the training if not given. The twin is always in MuJoCo."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; the result does not depend on it."""


def run_transfer(config: Transfer, progress: Progress = SILENT) -> Results:
    """Evaluate, or read the finished evaluation.

    Raises:
        ArtifactError, ConfigError: a policy, its motors or the fleet cannot be used.
    """
    robot = load_robot(config.robot)
    robot.require_legs()
    fleet = load_robot_fleet(robot, config.fleet)
    files = [path if path.is_file() else path / POLICY for path in config.walks]
    if not files:
        raise ConfigError("no policy given", remedy="give the folders of at least one walk")
    require_count("workers", config.workers)
    policies = [Policy.load(path) for path in files]
    settings = asdict(config)
    del settings["workers"]  # the result does not depend on it
    wanted = description("transfer", settings, [*files, *fleet_files(robot, config.fleet), *robot.files])
    if not is_finished(config.out, wanted):
        commands = twin.straight_ahead(twin.with_shared_speeds(robot, policies))
        walks: list[TrainedWalk] = []
        with ExitStack() as simulators:
            for path in files:
                walks.append(trained_walk(path, robot, config.engine, commands=commands))
                simulators.callback(walks[-1].simulator.close)
            with working(config.out, wanted):
                _evaluate_all(config, walks, fleet, commands, progress)
    return read_results(config.out)


def _evaluate_all(
    config: Transfer, walks: list[TrainedWalk], fleet: Fleet, commands: Commands, progress: Progress
) -> None:
    rows: list[Result] = []
    seeds, traces = Counter[str](), dict[str, np.ndarray]()
    works = [partial(_own_and_twin, walk, fleet, commands) for walk in walks]
    found = in_parallel(works, usable_threads(config.workers, progress), progress)
    for walk, environments in zip(walks, found, strict=True):
        condition, seed = walk.condition, seeds[walk.condition]
        for name, (walking, trace) in environments.items():
            rows += [
                Result(key, unit, getattr(walking, key), condition, name, seed=seed)
                for key, unit in twin.WALKING_UNITS.items()
            ]
            traces.setdefault(f"{name}/{condition}", trace)
        seeds[condition] += 1
    write_results(config.out, Results.of(rows))
    write_tensors(config.out / TRACES, traces, {"control_dt": walks[0].robot.control_dt, "robot": config.robot})


def _own_and_twin(
    walk: TrainedWalk, fleet: Fleet, commands: Commands, progress: Progress
) -> dict[str, tuple[twin.Walking, np.ndarray]]:
    robot, policy = walk.robot, walk.policy
    simulators = {"own": walk.simulator, "twin": twin.twin_simulator(robot, fleet, policy.gait, commands)}
    with progress.start(
        f"transfer of {walk.name}: {len(simulators)} x {twin.DRAWS} walks", len(simulators) * twin.DRAWS
    ) as task:
        return {name: twin.evaluate(robot, policy, simulator, task.advance) for name, simulator in simulators.items()}
