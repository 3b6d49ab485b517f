"""Evaluate policies in their training simulation and on the twin."""

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
from motorprior.pipeline.motor_choice import MotorChoice, load_robot_fleet
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
from motorprior.transfer import twin

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


@dataclass(frozen=True)
class TrainedWalk:
    """Attributes: name; robot with the policy's speed range; policy; training condition; its training simulation."""

    name: str
    robot: Robot
    policy: Policy
    condition: str
    simulator: WalkSimulator | BackendSimulator


def trained_walk(
    path: Path,
    robot: Robot,
    engine: Engine | None = None,
    walk: WalkConfig | None = None,
    commands: Commands | None = None,
) -> TrainedWalk:
    """A policy with its training simulation.

    Args:
        path: the policy's file.
        robot: of the policy.
        engine: of the simulation; that of the training if not given.
        walk: the episode, with the policy's gait; 5 s with the training's randomization if not given.
        commands: of the default episode; `straight_ahead` if not given.

    Raises:
        ArtifactError, ConfigError: a damaged policy or one of another control period, missing motors, or an engine
            that is not installed.
    """
    policy, robot = policy_for(path, robot)
    if walk is None:
        commands = commands or twin.straight_ahead(robot)
        walk = WalkConfig(twin.DURATION_STEPS, randomization=_randomization(policy, path), commands=commands)
    motors = choice_from_json(policy.provenance.get("motors"), path)
    scene = training_scene(policy, path, robot, walk, engine, motors)
    return TrainedWalk(path.parent.name, robot, policy, motors.condition(), scene.simulator())


def policy_for(path: Path, robot: Robot) -> tuple[Policy, Robot]:
    """A policy of this robot, and the robot with the policy's speed range.

    Raises:
        ArtifactError, ConfigError: a damaged policy, of another robot or another control period.
    """
    policy = Policy.load(path)
    policy.require_robot(robot, path)
    policy.require_clock(robot.control_dt, path)
    return policy, robot.with_speed_range(policy.forward)


def training_scene(
    policy: Policy,
    path: Path,
    robot: Robot,
    walk: WalkConfig,
    engine: Engine | None = None,
    motors: MotorChoice | None = None,
) -> Scene:
    """The simulation in which a policy was trained.

    Args:
        policy: the trained policy.
        path: its file, for errors and to find the files of its motors.
        robot: with the policy's speed range.
        walk: the episode, with the policy's gait.
        engine: instead of that of the training.
        motors: of the training; read from the policy's provenance if not given.

    Raises:
        ArtifactError, ConfigError: missing motors, or damaged provenance.
    """
    motors = motors or choice_from_json(policy.provenance.get("motors"), path)
    try:
        sample = motors.sampler(robot)
    except (ArtifactError, ConfigError) as error:
        where = path if error.where is None else f"{path}: {error.where}"
        raise type(error)(f"motors of its training: {error.problem}", where=where, remedy=error.remedy) from error
    stated: dict[str, Any] = {"engine": "mujoco", "roughness": 0.0}
    stated |= {key: policy.provenance[key] for key in stated if key in policy.provenance}
    Schema({"engine": one_of(*ENGINES), "roughness": number()}, "train again").check(stated, path)
    engine = engine or cast(Engine, stated["engine"])
    terrain = Terrain(float(stated["roughness"]) if engine == "pybullet" else 0.0)
    return Scene(robot, engine, sample, motors.physics_dt(robot), replace(walk, gait=policy.gait), terrain)


def _randomization(policy: Policy, path: Path) -> Randomization:
    """Randomization of its training; none if the provenance has none."""
    try:
        return Randomization(**policy.provenance.get("randomization", {}))
    except (TypeError, ConfigError) as error:
        raise ArtifactError(f"its randomization: {error}", where=path, remedy="train again") from error


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
