"""Train a walking policy into a folder, on motors drawn for every episode."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from motorprior.artifacts import write_json
from motorprior.exceptions import ConfigError
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.locomotion.executor import Kind, require_executor
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.policy_search import BestPolicy
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.locomotion.task import TaskWeights
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.engines import Engine, Scene
from motorprior.simulation.motors import SimulatedMotors, motors_as_json, simulated_motors
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.training import (
    CHECKPOINT,
    Training,
    executors,
    policy_of,
    report_faults,
    require_sizes,
    training_notes,
)
from motorprior.stage import description, digest, is_finished, usable_threads, working

POLICY, CURVE = "policy.safetensors", "curve.json"


@dataclass(frozen=True)
class Walk:
    """Train a walking policy."""

    out: Path
    """Folder for policy.safetensors, curve.json, metrics.jsonl and the checkpoint."""
    motors: str
    """The motors of every episode: prior:FILE, posterior:FILE,prior=FILE, pd, pd:kp=8.8,kd=0.84, fleet or fleet:NAME.
    docs/training.md has their options."""
    start: Path | None = None
    """A policy in another folder to continue from, with other motors for example, within its range of speeds; the plain
    gait if not given."""
    iterations: int = 200
    """ARS iterations."""
    patience: int | None = None
    """Stop after so many evaluations, one every 10 iterations, without a better policy; never if not given."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose physical motors policies are evaluated to choose the best; the motors of
    the training if not given. Not the fleet of a twin on which the policy is tested later."""
    episode_steps: int = 1000
    """Control steps per episode. Policies of short episodes may fall later, from errors that grow slowly."""
    gait: GaitName = "trot"
    """Gait: phases of the legs."""
    commands: Commands = field(default_factory=Commands)
    """Commanded speeds, also above the robot's usual range."""
    hidden_units: int = 0
    """Hidden units of the policy, an even number if it is symmetric; 0 for a linear one."""
    symmetric: bool = True
    """Mirrored observations give mirrored actions, so that the policy cannot limp to one side."""
    search: ArsConfig = field(default_factory=ArsConfig)
    """Augmented random search."""
    task: TaskWeights = field(default_factory=TaskWeights)
    """Reward."""
    workers: int = min(2, os.cpu_count() or 1)
    """Episodes at a time, at most the number of cores, except on a Ray cluster. The result does not depend on it."""
    engine: Engine = "mujoco"
    """Physics engine; PyBullet holds the interpreter lock, so that only the executor ray uses several cores."""
    roughness: float = 0.0
    """Height of the bumps of rough ground [m], up to 4 m from the start; PyBullet only."""
    randomization: Randomization = ROBUST
    """Randomization of each episode in addition to the motors: floor, masses, slope, sensors, pushes."""
    executor: Kind = "threads"
    """serial, threads of this process, or Ray processes; the result does not depend on it."""
    ray_address: str | None = None
    """A running Ray cluster for the executor ray; Ray starts on this machine if not given."""
    tensorboard: bool = False
    """Also write the learning curve for TensorBoard, into the folder tensorboard; needs the extra tensorboard."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_walk(config: Walk, progress: Progress = SILENT, name: str = "walk") -> bool:
    """Train or resume, unless the folder is finished with these settings. A training with other settings is replaced.

    Returns:
        Whether it trained.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a file or folder that cannot be used.
        SimulationFault: every episode had one.
        KeyboardInterrupt: after a checkpoint of the complete iterations.
    """
    plan = _planned(config)
    if is_finished(config.out, plan.wanted):
        return False
    require_executor(config.executor, config.ray_address)
    for line in training_notes(plan.robot, plan.motors.prior, config.validation):
        progress.note(line)
    with working(config.out, plan.wanted):
        _train(plan, progress, name)
    (config.out / CHECKPOINT).unlink(missing_ok=True)  # after the marker: a run killed before resumes from it
    return True


@dataclass(frozen=True)
class _Plan:
    """Checked settings and loaded inputs of a walk."""

    config: Walk
    robot: Robot  # with the speed range of the training
    shape: PolicyShape
    start: Policy | None
    motors: SimulatedMotors
    scenes: list[Scene]  # of the training, and of the evaluation if it has other motors
    wanted: dict[str, Any]  # description of the stage


def _planned(config: Walk) -> _Plan:
    require_sizes(config.iterations, config.episode_steps, config.workers, config.hidden_units, config.patience)
    if config.start is not None and config.start.resolve() == (config.out / POLICY).resolve():
        raise ConfigError(
            f"start is {POLICY} of the folder out itself, which the training would overwrite", where=config.start,
            remedy="give another folder as out", argument="out",
        )  # fmt: skip
    if config.tensorboard and find_spec("tensorboardX") is None:
        remedy = "pip install 'motorprior[tensorboard]'"
        raise ConfigError("tensorboardX is not installed", remedy=remedy, argument="tensorboard")
    robot = load_robot(config.robot)
    start = None if config.start is None else Policy.load(config.start)
    if start is not None:
        start.require_robot(robot, config.start)
        start.require_gait(config.gait, config.start)
        robot = robot.with_speed_range(start.forward)
    robot = config.commands.extend_range(robot)
    texts = [config.motors, *([] if config.validation is None else [f"fleet:{config.validation}"])]
    motors = [simulated_motors(text, robot) for text in texts]
    scenes = [scene(config, robot, each.draw, each.physics_dt) for each in motors]
    without_effect = ("workers", "executor", "ray_address", "tensorboard")  # on the result
    settings = {name: value for name, value in asdict(config).items() if name not in without_effect}
    inputs = [*robot.files, *([] if config.start is None else [config.start])]
    inputs += [file for each in motors for file in each.files]
    shape = PolicyShape.of(robot, config.gait, config.hidden_units, config.symmetric)
    return _Plan(config, robot, shape, start, motors[0], scenes, description("walk", settings, inputs))


def scene(config: Walk, robot: Robot, draws: DrawMotors, physics_dt: float) -> Scene:
    """The simulation of a walk, on motors from ``draws``, at a step of ``physics_dt`` [s]."""
    walk = WalkConfig(config.episode_steps, config.task, config.randomization, config.commands, config.gait)
    return Scene(robot, config.engine, draws, physics_dt, walk, Terrain(config.roughness))


def _train(plan: _Plan, progress: Progress, name: str) -> None:
    config = plan.config
    workers = config.workers if config.ray_address is not None else usable_threads(config.workers, progress)

    def save(best: BestPolicy) -> None:
        _policy(plan, best).save(config.out / POLICY)

    training = Training(
        config.search, plan.shape, plan.start, config.iterations, config.patience, config.episode_steps, config.out,
        plan.wanted, save, config.tensorboard,
    )  # fmt: skip
    with executors(plan.scenes, workers, config.executor, config.ray_address) as (executor, evaluator):
        best, curve = training.run(executor, evaluator, progress, name)
    report_faults(curve, 2 * config.search.num_directions, progress)
    save(best)
    write_json(config.out / CURVE, curve)


def _policy(plan: _Plan, best: BestPolicy) -> Policy:
    config = plan.config
    provenance = {
        "motors": motors_as_json(config.motors, config.out),
        "search": asdict(config.search),
        "task": asdict(config.task),
        "start_sha256": None if config.start is None else digest(config.start),
        "iterations": config.iterations,
        "patience": config.patience,
        "validation": config.validation and motors_as_json(f"fleet:{config.validation}", config.out),
        "episode_steps": config.episode_steps,
        "engine": config.engine,
        "roughness": config.roughness,
        "randomization": config.randomization.as_json(),
        "commands": asdict(config.commands),
        "symmetric": config.symmetric,
    }
    return policy_of(plan.robot, config.gait, best, plan.motors.nominal, provenance)
