"""ARS trains a PMTG policy on motors drawn for every episode."""

from __future__ import annotations

import os
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path

from motorprior.artifacts import write_json
from motorprior.bounds import require_count
from motorprior.exceptions import ConfigError, SimulationFault
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.task import TaskWeights
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.prior_file import doubts, load_prior
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.stage import description, digest, is_finished, locked, threads_here, working
from motorprior.pipeline.walking.contests import NO_JUDGE, executors, is_of_the_twin, validation_motors
from motorprior.pipeline.walking.earlier_training import tell_what_is_lost
from motorprior.pipeline.walking.motor_provenance import choice_as_json
from motorprior.pipeline.walking.tensorboard import EVENTS, require_tensorboard, write_events
from motorprior.pipeline.walking.trained_policy import judge_faults, policy_of
from motorprior.pipeline.walking.training import CHECKPOINT, Checkpoint, Training
from motorprior.pipeline.walking.walk_metrics import METRICS, Extent
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.search.ars import ArsConfig
from motorprior.search.executor import Kind, require_executor
from motorprior.search.policy_search import Champion
from motorprior.search.policy_shape import PolicyShape, units_for
from motorprior.simulation.engines import Engine, Scene
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.terrain import Terrain

POLICY, CURVE = "policy.safetensors", "curve.json"
MOST_WORKERS, MOST_UNITS = 1024, 256
MOST_EPISODE_STEPS = 100_000
"""Of control: half an hour at 50 Hz."""


@dataclass(frozen=True)
class Walk:
    """Train a walking policy."""

    out: Path
    """Folder for policy.safetensors, curve.json, metrics.jsonl and the checkpoint."""
    motors: MotorChoice = field(default_factory=MotorChoice)
    """The motors of every episode."""
    start: Path | None = None
    """A policy in another folder to go on from, with other motors for example; without one it starts from the gait
    itself. The range of its speeds is kept."""
    iterations: int = 200
    """ARS iterations."""
    patience: int | None = None
    """Stop after so many contests, one every 10 iterations, without a better policy; never if not given."""
    validation: str | None = None
    """Fleet, a name or a .toml file, on whose physical motors the contests are walked that decide which policy is kept;
    on the motors of the training if not given. Not the fleet of a twin that is to judge the policy."""
    episode_steps: int = 1000
    """Control steps per episode. In a shorter one a policy does not meet what grows slowly as it walks on, for which it
    may fall later."""
    gait: GaitName = "trot"
    """Which leg steps when."""
    commands: Commands = field(default_factory=Commands)
    """What the robot is told to do; faster than it usually is, too."""
    hidden_units: int = 0
    """Hidden units of the policy, an even number of a symmetric one; none for a linear one."""
    symmetric: bool = True
    """The policy answers what it would observe in a mirror with the mirrored action: it cannot limp to one side."""
    search: ArsConfig = field(default_factory=ArsConfig)
    """Augmented random search."""
    task: TaskWeights = field(default_factory=TaskWeights)
    """Reward."""
    workers: int = min(2, os.cpu_count() or 1)
    """Episodes at a time, at most as many as there are cores; on a cluster, as the executor ray says. The result does
    not depend on it."""
    engine: Engine = "mujoco"
    """Physics engine; PyBullet holds the interpreter lock, so that only the executor ray uses more cores."""
    roughness: float = 0.0
    """Height of the bumps of a rough ground [m]; PyBullet only. It ends 4 m from the start."""
    randomization: Randomization = ROBUST
    """What differs between episodes besides the motors: floor, masses, slope, sensors, pushes."""
    executor: Kind = "threads"
    """One episode after the other, threads of this process, or Ray's processes; the result does not depend on it."""
    ray_address: str | None = None
    """A running Ray cluster to join, with the executor ray; without one Ray starts on this machine only."""
    tensorboard: bool = False
    """Also write the learning curve for TensorBoard, into the folder tensorboard; needs the extra tensorboard."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_walk(config: Walk, progress: Progress = SILENT, name: str = "walk") -> bool:
    """Train, resume, or, if the folder holds this very policy, do no more than to write events that are asked for.

    What the folder holds of other settings is thrown away, which ``progress`` is told.

    Returns:
        Whether it trained: False where the folder was finished.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a file or folder that cannot be used.
        SimulationFault: every episode broke down.
        KeyboardInterrupt: after a checkpoint of the iterations that are complete.
    """
    plan = _planned(config)
    if is_finished(config.out, plan.wanted):
        if config.tensorboard:
            write_events(config.out)
        (config.out / CHECKPOINT).unlink(missing_ok=True)  # of a process that was killed at its very end
        return False
    require_executor(config.executor, config.ray_address)
    for line in plan.doubts():
        progress.note(line)
    scenes = plan.scenes()
    with locked(config.out):
        tell_what_is_lost(config.out, plan.wanted, progress)
        with working(config.out, plan.wanted):
            _train(plan, scenes, progress, name)
        (config.out / CHECKPOINT).unlink(missing_ok=True)  # after the marker: a run killed before resumes from it
    return True


def require_possible(config: Walk) -> None:
    """Raise the ConfigError or ArtifactError that `run_walk` would for its settings or files, and touch nothing."""
    plan = _planned(config)
    require_executor(config.executor, config.ray_address)
    plan.scenes()


def _train(plan: _Plan, scenes: list[Scene], progress: Progress, name: str) -> None:
    """Train from the checkpoint, if there is one, and write what came out."""
    config = plan.config
    workers = config.workers if config.ray_address is not None else threads_here(config.workers, progress)
    patient = config.patience is not None
    extent = Extent(config.iterations, config.episode_steps, 2 * config.search.num_directions, may_end_early=patient)
    checkpoint = Checkpoint(config.out, plan.wanted)
    with executors(scenes, workers, config.executor, config.ray_address) as (executor, judge):
        training = Training(
            config.search, plan.shape, plan.start, executor, judge, extent, config.patience, checkpoint,
            save=lambda best: _policy(plan, best).save(config.out / POLICY),
            tensorboard=config.tensorboard,
        )  # fmt: skip
        champion, curve = training.run(progress, name)
    try:
        judge_faults(curve, extent.episodes, progress)
    except SimulationFault:  # there is nothing to go on from
        (config.out / CHECKPOINT).unlink(missing_ok=True)
        (config.out / METRICS).unlink(missing_ok=True)
        shutil.rmtree(config.out / EVENTS, ignore_errors=True)
        raise
    _policy(plan, champion).save(config.out / POLICY)
    write_json(config.out / CURVE, curve)


@dataclass(frozen=True)
class _Motors:
    """Motors of an episode as they were chosen, and what draws them."""

    choice: MotorChoice
    draws: DrawMotors


@dataclass(frozen=True)
class _Plan:
    """What follows from the settings of a walk.

    Attributes:
        config: the settings.
        robot: told all speeds of the training.
        shape: of the policy.
        start: policy to go on from.
        motors: of the training.
        judges: motors of the contests, where they are others.
        wanted: description of the stage.
    """

    config: Walk
    robot: Robot
    shape: PolicyShape
    start: Policy | None
    motors: _Motors
    judges: _Motors | None
    wanted: dict

    def doubts(self) -> list[str]:
        """What a user should know of his prior and of his validation fleet."""
        config, robot = self.config, self.robot
        found = [] if config.motors.prior is None else doubts(load_prior(config.motors.prior, robot), robot)
        return found + ([NO_JUDGE] if config.validation and is_of_the_twin(config.validation, robot) else [])

    def scenes(self) -> list[Scene]:
        """Of the candidates, and of the contests where they are walked on other motors.

        Raises:
            ConfigError: see `scene`.
        """
        motors = [self.motors, *([] if self.judges is None else [self.judges])]
        return [scene(self.config, self.robot, each.draws, each.choice.physics_dt(self.robot)) for each in motors]


def _planned(config: Walk) -> _Plan:
    """Read what the settings name.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a file that cannot be used.
    """
    for name, least, most in (
        ("iterations", 1, None), ("episode_steps", 1, MOST_EPISODE_STEPS), ("workers", 1, MOST_WORKERS),
        ("hidden_units", 0, MOST_UNITS),
    ):  # fmt: skip
        require_count(name, getattr(config, name), least, most)
    if config.patience is not None:
        require_count("patience", config.patience)
    if config.tensorboard:
        require_tensorboard()
    units = units_for(config.hidden_units, config.symmetric)
    _refuse_to_overwrite_the_start(config)
    robot = load_robot(config.robot)
    start = _start(config, robot)
    robot = config.commands.on(robot if start is None else start.commanded(robot))
    motors = _Motors(config.motors, config.motors.drawer(robot))  # refuses what cannot be, before digests are made
    judges = None
    if config.validation is not None:
        choice = MotorChoice("fleet", fleet=config.validation)
        judges = _Motors(choice, validation_motors(config.validation, robot)[0])
    settings = asdict(config)
    for where in ("workers", "executor", "ray_address", "tensorboard"):  # the result does not depend on them
        del settings[where]
    inputs = [*config.motors.inputs(robot), *robot.files]
    inputs += [config.start] if config.start is not None else []
    inputs += judges.choice.inputs(robot) if judges is not None else []
    shape = PolicyShape.of(robot, config.gait, units, config.symmetric)
    wanted = description("walk", settings, inputs)
    return _Plan(config, robot, shape, start, motors, judges, wanted)


def scene(config: Walk, robot: Robot, draws: DrawMotors, physics_dt: float) -> Scene:
    """What a worker simulates on motors that are drawn so, at a step of ``physics_dt`` [s].

    Raises:
        ConfigError: the engine is not installed, or cannot do what is asked.
    """
    walk = WalkConfig(config.episode_steps, config.task, config.randomization, config.commands, config.gait)
    return Scene(robot, config.engine, draws, physics_dt, walk, Terrain(config.roughness))


def _policy(plan: _Plan, champion: Champion) -> Policy:
    config = plan.config
    provenance = {
        "motors": choice_as_json(config.motors, config.out),
        "search": asdict(config.search),
        "task": asdict(config.task),
        "start_sha256": None if config.start is None else digest(config.start),
        "iterations": config.iterations,
        "patience": config.patience,
        "validation": None if plan.judges is None else choice_as_json(plan.judges.choice, config.out),
        "episode_steps": config.episode_steps,
        "engine": config.engine,
        "roughness": config.roughness,
        "randomization": config.randomization.as_json(),
        "commands": asdict(config.commands),
        "symmetric": config.symmetric,
    }
    return policy_of(plan.robot, config.gait, champion, config.motors.nominal(plan.robot), provenance)


def _refuse_to_overwrite_the_start(config: Walk) -> None:
    """Refuse to train into the folder of the policy to start from.

    Raises:
        ConfigError: it is the file that the training would write.
    """
    if config.start is not None and config.start.resolve() == (config.out / POLICY).resolve():
        raise ConfigError(
            f"start is {POLICY} of the folder out itself, which the training would overwrite", where=config.start,
            remedy="give another folder as out", argument="out",
        )  # fmt: skip


def _start(config: Walk, robot: Robot) -> Policy | None:
    """The policy to go on from, if there is one."""
    if config.start is None:
        return None
    start = Policy.load(config.start)
    start.require_robot(robot, config.start)
    start.require_gait(config.gait, config.start)
    return start
