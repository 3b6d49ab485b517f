"""A walking policy from objects: robot and motors in, policy out, nothing on disk."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import Fleet
from motorprior.bounds import require_count, require_seed
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.task import TaskWeights
from motorprior.pipeline.motor_choice import MotorChoice, MotorSource, drawn_from, load_robot_fleet, nominal_pd
from motorprior.pipeline.prior_file import doubts
from motorprior.pipeline.progress import WARNED, Progress
from motorprior.pipeline.stage import threads_here
from motorprior.pipeline.walking.contests import NO_JUDGE, executors, is_of_the_twin, validation_motors
from motorprior.pipeline.walking.trained_policy import judge_faults, policy_of
from motorprior.pipeline.walking.training import as_point
from motorprior.pipeline.walking.walk import MOST_EPISODE_STEPS, MOST_UNITS, MOST_WORKERS
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.search.ars import ArsConfig
from motorprior.search.policy_search import Champion, Iteration, contest, new_search, train
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
        motors: a prior, a posterior or a fleet to draw from; motors, the same in every episode; or a function that
            draws them from a generator.
        iterations: of the search, 32 episodes each, at most.
        patience: stop after so many contests, one every 10 iterations, without a better policy; never if not given.
        seed: of the search and of the draws; same arguments, same bytes, whatever ``workers``.
        workers: episodes at a time; two, or as many as there are cores, if not given.
        episode_steps: control steps per episode; see `Walk.episode_steps`.
        gait: which leg steps when, see `locomotion.gaits`.
        commands: what the robot is told to do; all that it is built for, and a little more, if not given.
        randomization: what differs between episodes besides the motors: floor, masses, slope, sensors, pushes.
        start: a policy to go on from; the gait itself if not given. What comes out is never worse on its own motors.
        symmetric: the policy answers what it would observe in a mirror with the mirrored action: it cannot limp to
            one side.
        hidden_units: of the policy, an even number of a symmetric one; none for a linear one.
        validation: a fleet, its name or its .toml file, on whose physical motors the contests are walked that decide
            which policy is kept; on the motors of the training if not given. Not the fleet of a twin that is to judge
            the policy.
        progress: where to report to.

    Returns:
        The best policy on the way.

    Raises:
        ConfigError: a robot without legs, motors that do not fit it, a number out of range, a start of another shape,
            or symmetry of a robot or a gait that has none.
        ArtifactError: a robot or a validation fleet that cannot be read.
        SimulationFault: every episode broke down.
    """
    told, robot = commands or Commands(), as_robot(robot)
    if start is not None:
        start.require_robot(robot, "start")
        start.require_gait(gait, "start")
        robot = start.commanded(robot)
    robot = told.on(robot)
    workers = min(2, os.cpu_count() or 1) if workers is None else workers
    for name, value, most in (
        ("iterations", iterations, None), ("episode_steps", episode_steps, MOST_EPISODE_STEPS),
        ("workers", workers, MOST_WORKERS), *([] if patience is None else [("patience", patience, None)]),
    ):  # fmt: skip
        require_count(name, value, 1, most)
    require_count("hidden_units", hidden_units, 0, MOST_UNITS)
    shape = PolicyShape.of(robot, gait, units_for(hidden_units, symmetric), symmetric)
    require_seed(seed)
    draw, physics_dt = drawn_from(motors, robot)
    prior = motors.prior if isinstance(motors, MotorPosterior) else motors
    for line in doubts(prior, robot) if isinstance(prior, MotorPrior) else ():
        progress.note(line)
    config = ArsConfig(seed=seed)
    drawn = [(draw, physics_dt)]
    if validation is not None:
        drawn.append(validation_motors(validation, robot))
        if is_of_the_twin(validation, robot):
            progress.note(NO_JUDGE)
    walk = WalkConfig(episode_steps, randomization=randomization, commands=told, gait=gait)
    scenes = [Scene(robot, "mujoco", draw, physics_dt, walk) for draw, physics_dt in drawn]
    search, champion = new_search(config, shape, start), Champion.none_yet(shape)
    curve: list[dict[str, Any]] = []
    with (
        executors(scenes, threads_here(workers, progress)) as (executor, judge),
        progress.start(f"train: {iterations} iterations", iterations) as task,
    ):

        def report(point: Iteration, best: Champion) -> None:
            curve.append(as_point(point))
            off = point.mean_speed_error
            task.advance(1, f"return {point.mean_return:.2f} m, off the speed by {off:.2f} m/s")

        champion = contest(search, shape, judge, champion)  # what nothing improves on is kept
        champion = train(search, shape, executor, iterations, champion, report, judge, patience)
    judge_faults(curve, 2 * config.num_directions, progress)
    provenance = {
        "motors": str(type(motors).__name__), "search": asdict(config), "task": asdict(TaskWeights()),
        "iterations": iterations, "patience": patience, "episode_steps": episode_steps, "engine": "mujoco",
        "commands": asdict(told), "randomization": randomization.as_json(), "symmetric": symmetric,
        "validation": None if validation is None else load_robot_fleet(robot, validation).name,
    }  # fmt: skip
    return policy_of(robot, gait, champion, _nominal(robot, motors), provenance)


def _nominal(robot: Robot, motors: MotorSource) -> IdealPd:
    """The gains that the robot's own motors run with: a fleet's, or those that the robot is known for."""
    return nominal_pd(motors, robot.num_joints) if isinstance(motors, Fleet) else MotorChoice().nominal(robot)
