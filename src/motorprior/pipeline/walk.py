"""ARS trains a PMTG policy on motors drawn for every episode."""

from __future__ import annotations

import os
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.artifacts import read_tensors, write_json, write_tensors
from motorprior.bounds import require_count
from motorprior.exceptions import ArtifactError, ConfigError, MotorPriorError, SimulationFault
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.task import TaskWeights
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.motor_provenance import choice_as_json
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.side_by_side import threads_here
from motorprior.pipeline.stage import Stopwatch, description, digest, is_finished, remove, working
from motorprior.pipeline.walk_metrics import METRICS, Extent, Metrics
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.search.ars import Ars, ArsConfig
from motorprior.search.executor import Executor, Kind, make_executor
from motorprior.search.policy_search import Champion, Iteration, contest, new_search, train
from motorprior.search.policy_shape import PolicyShape
from motorprior.simulation.engines import Engine, Scene
from motorprior.simulation.fatal_errors import saved_on_fatal_error
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.world import FAULTS

POLICY, CURVE, CHECKPOINT = "policy.safetensors", "curve.json", "search.safetensors"
_SAVING_SHARE = 0.5
"""Every iteration is saved, unless saving took more than this share of the time since the last time."""
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
    """A policy to go on from, with other motors for example; without one it starts from the gait itself. The range
    of its speeds is kept."""
    iterations: int = 200
    """ARS iterations."""
    episode_steps: int = 500
    """Control steps per episode."""
    gait: GaitName = "trot"
    """Which leg steps when."""
    commands: Commands = field(default_factory=Commands)
    """What the robot is told to do; faster than it usually is, too."""
    hidden_units: int = 0
    """Hidden units of the policy; none for a linear one."""
    symmetric: bool = True
    """The policy answers what it would observe in a mirror with the mirrored action: it cannot limp."""
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
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_walk(config: Walk, progress: Progress = SILENT, name: str = "walk") -> None:
    """Train, resume, or do nothing if the folder holds this very policy.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a file or folder that cannot be used.
        SimulationFault: every episode broke down.
        KeyboardInterrupt: after a checkpoint of the iterations that are complete.
    """
    require_count("iterations", config.iterations)
    require_count("episode_steps", config.episode_steps, 1, MOST_EPISODE_STEPS)
    require_count("workers", config.workers, 1, MOST_WORKERS)
    require_count("hidden_units", config.hidden_units, 0, MOST_UNITS)
    units = -(-config.hidden_units // 2) if config.symmetric else config.hidden_units
    robot = load_robot(config.robot)
    start = _start(config, robot)
    robot = config.commands.on(robot if start is None else start.commanded(robot))
    shape = PolicyShape.of(robot, config.gait, units, config.symmetric)
    draw = config.motors.drawer(robot)
    settings = asdict(config)
    for where in ("workers", "executor", "ray_address"):  # the result does not depend on them
        del settings[where]
    inputs = config.motors.inputs(robot) + ([] if config.start is None else [config.start])
    wanted = description("walk", settings, [*inputs, *robot.files])
    if is_finished(config.out, wanted):
        return
    make_simulator = scene(config, robot, draw).simulator
    if config.ray_address is not None and config.executor != "ray":
        raise ConfigError(
            "ray_address is for the executor ray", remedy="give both, or leave it out", argument="ray_address"
        )
    with working(config.out, wanted) as clock:
        workers = config.workers if config.ray_address is not None else threads_here(config.workers, progress)
        executor = make_executor(make_simulator, workers, config.executor, config.ray_address)
        try:
            champion, curve = _train(config, robot, shape, executor, _Kept(config.out, wanted, clock), progress, name)
        finally:
            executor.close()
        try:
            judge_faults(curve, 2 * config.search.num_directions, progress)
        except SimulationFault:  # there is nothing to go on from
            for left in (CHECKPOINT, METRICS):
                remove(config.out, left)
            raise
        _policy(config, robot, champion).save(config.out / POLICY)
        write_json(config.out / CURVE, curve)
        remove(config.out, CHECKPOINT)


def scene(config: Walk, robot: Robot, draw: DrawMotors) -> Scene:
    """What a worker simulates.

    Raises:
        ConfigError: the engine is not installed, or cannot do what is asked.
    """
    walk = WalkConfig(config.episode_steps, config.task, config.randomization, config.commands, config.gait)
    return Scene(robot, config.engine, draw, config.motors.physics_dt(robot), walk, Terrain(config.roughness))


def _train(
    config: Walk, robot: Robot, shape: PolicyShape, executor: Executor, kept: _Kept, progress: Progress, name: str
) -> tuple[Champion, list[dict]]:
    """Train from the checkpoint, if there is one; leave a checkpoint when interrupted or when episodes fail."""
    search, champion, curve = _restore(config, robot, shape, kept.wanted)
    if search.iteration == 0:  # what nothing improves on is kept
        champion = contest(search, shape, executor, champion)
    latest = _checkpoint(search, champion)
    extent = Extent(config.iterations, config.episode_steps, 2 * config.search.num_directions)
    metrics = Metrics(config.out, curve, extent)
    saved, took = time.monotonic(), 0.0

    def rescue() -> str:
        """Keep everything, and the best policy so far, when MuJoCo ends the process."""
        kept.save(latest, curve)
        what = f"{int(latest['iteration'])} iterations"
        best = Champion.restore({name: value for name, value in latest.items() if name.startswith("champion_")})
        if best.iteration >= 0:
            _policy(config, robot, best).save(config.out / POLICY)
            what += f" and the best policy so far, of iteration {best.iteration},"
        return f"{what} are kept in {config.out}"

    try:
        with (
            progress.start(f"{name}: {config.iterations} iterations", config.iterations) as task,
            saved_on_fatal_error(rescue),
        ):
            task.advance(search.iteration)

            def report(point: Iteration, best: Champion) -> None:
                nonlocal latest, saved, took
                curve.append(as_point(point))
                latest = _checkpoint(search, best)
                task.advance(1, metrics.add(curve[-1]))
                now = time.monotonic()
                if took <= _SAVING_SHARE * (now - saved):
                    kept.save(latest, curve)
                    saved = time.monotonic()
                    took = saved - now

            champion = train(search, shape, executor, config.iterations, champion, report)
    except (KeyboardInterrupt, MotorPriorError):  # the second: a fault of the simulation, or lost workers
        kept.save(latest, curve)
        raise
    return champion, curve


def as_point(point: Iteration) -> dict[str, Any]:
    """A point of the curve, with its faults by name."""
    return asdict(point) | {"faults": {FAULTS[fault]: n for fault, n in point.faults.items()}}


def judge_faults(curve: list[dict], episodes: int, progress: Progress) -> None:
    """Say which episodes of the training were no physics; each of them ended there, without reward.

    Args:
        curve: of the training, see `as_point`.
        episodes: of an iteration.
        progress: where to report to.

    Raises:
        SimulationFault: all of them.
    """
    faults, total = sum((Counter(point.get("faults", {})) for point in curve), Counter()), len(curve) * episodes
    for name, count in faults.items():
        progress.note(f"{count} of {total} episodes ended early: {name}")
    if faults.total() == total:
        raise SimulationFault(
            f"each of the {total} episodes broke down ({', '.join(faults)}): there is nothing to learn from",
            remedy="the motors are too stiff or too strong for the physics step: give smaller gains, or a softer gear",
        )


def _policy(config: Walk, robot: Robot, champion: Champion) -> Policy:
    provenance = {
        "motors": choice_as_json(config.motors, config.out),
        "search": asdict(config.search),
        "task": asdict(config.task),
        "start_sha256": None if config.start is None else digest(config.start),
        "iterations": config.iterations,
        "episode_steps": config.episode_steps,
        "engine": config.engine,
        "roughness": config.roughness,
        "randomization": config.randomization.as_json(),
        "commands": asdict(config.commands),
        "symmetric": config.symmetric,
    }
    return policy_of(robot, config.gait, champion, config.motors.nominal(robot), provenance)


def policy_of(robot: Robot, gait: GaitName, champion: Champion, nominal: IdealPd, provenance: dict[str, Any]) -> Policy:
    """The champion as a policy.

    Args:
        robot: that it commands.
        gait: that it was trained in.
        champion: what training found.
        nominal: the gains that its motors run with.
        provenance: how it was trained.
    """
    arrays = champion.policy
    return Policy(
        weights=np.ascontiguousarray(arrays.weights),
        hidden=arrays.hidden,
        readout=arrays.readout,
        observation_mean=arrays.mean,
        observation_std=arrays.std,
        kp=nominal.kp,
        kd=nominal.kd,
        control_dt=robot.control_dt,
        robot=robot.name,
        joint_names=robot.joint_names,
        forward=robot.require_legs().forward,
        gait=gait,
        provenance=provenance | {"iteration": champion.iteration, "own_return": champion.score},
    )


def _checkpoint(search: Ars, champion: Champion) -> dict[str, np.ndarray]:
    """Everything a later run needs to end at the same bytes."""
    return {**search.state(), **champion.state()}


@dataclass(frozen=True)
class _Kept:
    """Where the checkpoints of a training go."""

    folder: Path
    wanted: dict
    clock: Stopwatch

    def save(self, state: dict[str, np.ndarray], curve: list[dict]) -> None:
        """Write the state; the curve may be a point ahead when interrupted between the two, and is cut to it."""
        points = curve[: int(state["iteration"])]
        write_tensors(self.folder / CHECKPOINT, state, {"wanted": self.wanted, "curve": points})
        self.clock.note()


def _restore(config: Walk, robot: Robot, shape: PolicyShape, wanted: dict) -> tuple[Ars, Champion, list[dict]]:
    """The training of an interrupted run with the same settings, or a new one.

    Raises:
        ArtifactError: the checkpoint is damaged.
    """
    path = config.out / CHECKPOINT
    if path.is_file():
        try:
            state, header = read_tensors(path)
            if header.get("wanted") == wanted:
                best = {name: state.pop(name) for name in list(state) if name.startswith("champion_")}
                return Ars.restore(config.search, state), Champion.restore(best), header["curve"]
        except (ArtifactError, KeyError) as error:
            problem = error.problem if isinstance(error, ArtifactError) else f"no {error}"
            raise ArtifactError(problem, where=path, remedy="delete it to train from the start") from error
    return new_search(config.search, shape, _start(config, robot)), Champion.none_yet(shape), []


def _start(config: Walk, robot: Robot) -> Policy | None:
    """The policy to go on from, if there is one."""
    if config.start is None:
        return None
    start = Policy.load(config.start)
    start.require_robot(robot, config.start)
    start.require_gait(config.gait, config.start)
    return start
