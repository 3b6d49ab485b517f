"""Every policy in its own simulation and on the twin."""

from __future__ import annotations

import os
from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from motorprior.artifacts import write_tensors
from motorprior.bench.fleet import Fleet
from motorprior.bounds import require_count
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.command import Commands
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.stage import (
    description,
    fleet_files,
    in_parallel,
    is_finished,
    read_results,
    usable_threads,
    working,
    write_results,
)
from motorprior.pipeline.walking.motor_provenance import choice_from_json
from motorprior.pipeline.walking.walk import POLICY
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.schema import Schema, number, one_of
from motorprior.simulation.backend_rollout import BackendSimulator
from motorprior.simulation.engines import ENGINES, Engine, Scene
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.terrain import Terrain
from motorprior.transfer.study import DRAWS, Walking, evaluate
from motorprior.transfer.twin import DURATION_STEPS, straight_ahead, together, twin_simulator

TRACES = "traces.safetensors"
_UNITS = {"speed": "m/s", "upright": "1", "drift": "m"}


@dataclass(frozen=True)
class Transfer:
    """Run policies where they were trained, and on the twin: unseen physical motors, 1 kHz, encoder noise."""

    walks: tuple[Path, ...]
    """Folders that `motorprior walk` wrote; several seeds of one actuator model are averaged."""
    out: Path
    """Folder for figures.json and the gaits of the report."""
    fleet: str | None = None
    """The twin's fleet; the robot's own if not given."""
    engine: Engine | None = None
    """Engine of a policy's own simulation; the one it was trained in, on its terrain, if not given. The twin is always
    in MuJoCo."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; the result does not depend on it."""


def run_transfer(config: Transfer, progress: Progress = SILENT) -> Results:
    """Evaluate, or read what this very evaluation found.

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
    policies = [Policy.load(path) for path in files]  # says whether it is one, before all of it is read for its digest
    settings = asdict(config)
    del settings["workers"]  # the result does not depend on it
    wanted = description("transfer", settings, [*files, *fleet_files(robot, config.fleet), *robot.files])
    if not is_finished(config.out, wanted):
        told = straight_ahead(together(robot, policies))
        walkers: list[Walker] = []
        with ExitStack() as simulators:
            for path in files:
                walkers.append(walker_of(path, robot, config.engine, commands=told))
                simulators.callback(walkers[-1].own.close)
            with working(config.out, wanted):
                _evaluate_all(config, walkers, fleet, told, progress)
    return read_results(config.out)


@dataclass(frozen=True)
class Walker:
    """A walk: its name, robot as the policy commands it, policy, what it was trained on, and in which simulation."""

    name: str
    robot: Robot
    policy: Policy
    condition: str
    own: WalkSimulator | BackendSimulator


def walker_of(
    path: Path,
    robot: Robot,
    engine: Engine | None = None,
    walk: WalkConfig | None = None,
    commands: Commands | None = None,
) -> Walker:
    """Everything a policy needs; refuses what cannot run here.

    Args:
        path: the policy's file.
        robot: that walks.
        engine: of its own simulation; the one it was trained in if not given.
        walk: the episode, whose gait is always the policy's; 5 s under what its training varied if not given.
        commands: of those 5 s; straight ahead as fast as the policy may be told if not given.

    Raises:
        ArtifactError, ConfigError: a damaged policy, one of another control period, motors that are gone, or an engine
            that is not installed.
    """
    policy, robot = policy_for(path, robot)
    if walk is None:
        told = commands or straight_ahead(robot)
        walk = WalkConfig(DURATION_STEPS, randomization=_randomization(policy, path), commands=told)
    choice = choice_from_json(policy.provenance.get("motors"), path)
    scene = own_scene(policy, path, robot, walk, engine)
    return Walker(path.parent.name, robot, policy, choice.condition(), scene.simulator())


def policy_for(path: Path, robot: Robot) -> tuple[Policy, Robot]:
    """A policy of this robot, and the robot as the policy commands it.

    Raises:
        ArtifactError, ConfigError: a damaged policy, of another robot or another control period.
    """
    policy = Policy.load(path)
    policy.require_robot(robot, path)
    policy.require_clock(robot.control_dt, path)
    return policy, policy.commanded(robot)


def own_scene(policy: Policy, path: Path, robot: Robot, walk: WalkConfig, engine: Engine | None = None) -> Scene:
    """The simulation that a policy was trained in.

    Args:
        policy: that was trained.
        path: its file, for messages and what it names.
        robot: as the policy commands it.
        walk: the episode, whose gait is always the policy's.
        engine: another than it was trained in.

    Raises:
        ArtifactError, ConfigError: motors that are gone, or a damaged description of where it was trained.
    """
    choice = choice_from_json(policy.provenance.get("motors"), path)
    try:
        draw = choice.sampler(robot)
    except (ArtifactError, ConfigError) as error:
        problem = f"the motors it was trained on: {error.problem}"
        where = path if error.where is None else f"{path}: {error.where}"
        raise type(error)(problem, where=where, remedy=error.remedy) from error
    trained_in, roughness = _ground(policy, path)
    engine = engine or trained_in
    terrain = Terrain(roughness if engine == "pybullet" else 0.0)
    return Scene(robot, engine, draw, choice.physics_dt(robot), replace(walk, gait=policy.gait), terrain)


def _randomization(policy: Policy, path: Path) -> Randomization:
    """What its training varied besides the motors; nothing if it does not say.

    Raises:
        ArtifactError: says something that cannot be.
    """
    try:
        return Randomization(**policy.provenance.get("randomization", {}))
    except (TypeError, ConfigError) as error:
        raise ArtifactError(f"its randomization: {error}", where=path, remedy="train again") from error


def _ground(policy: Policy, path: Path) -> tuple[Engine, float]:
    """Engine and roughness [m] that a policy was trained with; MuJoCo and flat if it does not say.

    Raises:
        ArtifactError: says something that cannot be.
    """
    said: dict[str, Any] = {"engine": "mujoco", "roughness": 0.0}
    said |= {key: policy.provenance[key] for key in said if key in policy.provenance}
    Schema({"engine": one_of(*ENGINES), "roughness": number()}, "train again").check(said, path)
    return cast(Engine, said["engine"]), float(said["roughness"])


def _evaluate_all(config: Transfer, walkers: list[Walker], fleet: Fleet, told: Commands, progress: Progress) -> None:
    results, seeds = Results(), Counter[str]()
    traces: dict[str, np.ndarray] = {}
    works = [partial(_own_and_twin, walker, fleet, told) for walker in walkers]
    found = in_parallel(works, usable_threads(config.workers, progress), progress)
    for walker, places in zip(walkers, found, strict=True):
        for place, (walking, trace) in places.items():
            results += _results(walking, walker.condition, place, seeds[walker.condition])
            traces.setdefault(f"{place}/{walker.condition}", trace)
        seeds[walker.condition] += 1
    write_results(config.out, results)
    write_tensors(config.out / TRACES, traces, {"control_dt": walkers[0].robot.control_dt, "robot": config.robot})


def _own_and_twin(
    walker: Walker, fleet: Fleet, told: Commands, progress: Progress
) -> dict[str, tuple[Walking, np.ndarray]]:
    """`evaluate` by place."""
    robot = walker.robot
    places = {"own": walker.own, "twin": twin_simulator(robot, fleet, walker.policy.gait, told)}
    with progress.start(f"transfer of {walker.name}: {len(places)} x {DRAWS} walks", len(places) * DRAWS) as task:
        return {place: evaluate(robot, walker.policy, there, task.advance) for place, there in places.items()}


def _results(walking: Walking, condition: str, place: str, seed: int) -> Results:
    return Results.of(
        Result(quantity, unit, getattr(walking, quantity), condition, place, seed=seed)
        for quantity, unit in _UNITS.items()
    )
