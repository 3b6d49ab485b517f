"""A walking policy from objects: robot and motors in, policy out, nothing on disk."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import Fleet
from motorprior.bounds import require_count, require_seed
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.task import TaskWeights
from motorprior.pipeline.motor_choice import MotorChoice, MotorSource, load_robot_fleet, motor_sampler, nominal_pd
from motorprior.pipeline.progress import WARNED, Progress
from motorprior.pipeline.stage import usable_threads
from motorprior.pipeline.walking.trained_policy import policy_of, report_faults
from motorprior.pipeline.walking.training import Curve, as_point, executors
from motorprior.pipeline.walking.walk import training_notes
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.search.ars import ArsConfig
from motorprior.search.policy_search import BestPolicy, Iteration, updated_best, new_search, train
from motorprior.search.policy_shape import PolicyShape, units_for
from motorprior.simulation.engines import Scene
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.rollout import WalkConfig


def train_policy(
    robot: Robot | str | Path,
    motors: MotorSource,
    *,
    iterations: int = 200,
    patience: int | None = None,
    seed: int = 0,
    workers: int | None = None,
    episode_steps: int = 1000,
    gait: GaitName = "trot",
    commands: Commands | None = None,
    randomization: Randomization = ROBUST,
    start: Policy | None = None,
    symmetric: bool = True,
    hidden_units: int = 0,
    validation: Fleet | str | Path | None = None,
    progress: Progress = WARNED,
) -> Policy:
    """Train a walking policy by augmented random search in MuJoCo, on motors drawn for every episode.

    Args:
        robot: a legged one; a name, the path of a .toml file, or what `load_robot` gave.
        motors: a prior, a posterior or a fleet to draw from; fixed motors; or a function that draws them from a
            generator.
        iterations: of the search, 32 episodes each, at most.
        patience: stop after so many evaluations, one every 10 iterations, without a better policy; never if not given.
        seed: of the search and of the draws; same arguments, same bytes, whatever ``workers``.
        workers: episodes at a time; two, or as many as there are cores, if not given.
        episode_steps: control steps per episode; see `Walk.episode_steps`.
        gait: which leg steps when, see `locomotion.gaits`.
        commands: commanded speeds; the robot's whole range, and a little more, if not given.
        randomization: of each episode besides the motors: floor, masses, slope, sensors, pushes.
        start: a policy to continue from; the plain gait if not given. The result is never worse on the same motors.
        symmetric: mirrored observations give mirrored actions, so that the policy cannot limp to one side.
        hidden_units: of the policy, an even number if it is symmetric; 0 for a linear one.
        validation: a fleet, its name or its .toml file, on whose physical motors policies are evaluated to choose the
            best; the motors of the training if not given. Not the fleet of a twin on which the policy is tested later.
        progress: where to report to.

    Returns:
        The best policy of all evaluations.

    Raises:
        ConfigError: a robot without legs, motors that do not fit it, a number out of range, a start of another shape,
            or symmetry of a robot or a gait that has none.
        ArtifactError: a robot or a validation fleet that cannot be read.
        SimulationFault: every episode had one.
    """
    commands, robot = commands or Commands(), as_robot(robot)
    workers = min(2, os.cpu_count() or 1) if workers is None else workers
    for name, value in (("iterations", iterations), ("episode_steps", episode_steps), ("workers", workers)):
        require_count(name, value)
    if patience is not None:
        require_count("patience", patience)
    require_count("hidden_units", hidden_units, 0)
    require_seed(seed)
    if start is not None:
        start.require_robot(robot, "start")
        start.require_gait(gait, "start")
        robot = start.commanded(robot)
    robot = commands.on(robot)
    prior = motors.prior if isinstance(motors, MotorPosterior) else motors
    for line in training_notes(robot, prior if isinstance(prior, MotorPrior) else None, validation):
        progress.note(line)
    config, shape = ArsConfig(seed=seed), PolicyShape.of(robot, gait, units_for(hidden_units, symmetric), symmetric)
    walk = WalkConfig(episode_steps, randomization=randomization, commands=commands, gait=gait)
    sources = [motors, *([] if validation is None else [load_robot_fleet(robot, validation)])]
    scenes = [Scene(robot, "mujoco", *motor_sampler(source, robot), walk) for source in sources]
    search, champion, curve = new_search(config, shape, start), BestPolicy.none_yet(shape), Curve()
    with (
        executors(scenes, usable_threads(workers, progress)) as (executor, evaluator),
        progress.start(f"train: {iterations} iterations", iterations) as task,
    ):

        def report(point: Iteration, best: BestPolicy) -> None:
            curve.append(as_point(point))
            task.advance(1, f"return {point.mean_return:.2f} m, speed error {point.mean_speed_error:.2f} m/s")

        champion = updated_best(search, shape, evaluator, champion)  # the initial policy is kept if nothing improves on it
        champion = train(search, shape, executor, iterations, champion, report, evaluator, patience)
    report_faults(curve, 2 * config.num_directions, progress)
    provenance = {
        "motors": str(type(motors).__name__), "search": asdict(config), "task": asdict(TaskWeights()),
        "iterations": iterations, "patience": patience, "episode_steps": episode_steps, "engine": "mujoco",
        "commands": asdict(commands), "randomization": randomization.as_json(), "symmetric": symmetric,
        "validation": None if validation is None else load_robot_fleet(robot, validation).name,
    }  # fmt: skip
    is_fleet = isinstance(motors, Fleet)
    nominal = nominal_pd(motors, robot.num_joints) if is_fleet else MotorChoice().nominal(robot)
    return policy_of(robot, gait, champion, nominal, provenance)
