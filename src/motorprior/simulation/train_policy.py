"""Train a walking policy from objects, without files."""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path

from motorprior.bench.fleet import Fleet, load_robot_fleet
from motorprior.bounds import require_seed
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.locomotion.policy_search import BestPolicy, Iteration, new_search, train, updated_best
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.locomotion.task import TaskWeights
from motorprior.progress import WARNED, Progress
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.engines import Scene
from motorprior.simulation.motors import MotorSource, motor_sampler, simulated_motors
from motorprior.simulation.randomization import ROBUST, Randomization
from motorprior.simulation.rollout import WalkConfig
from motorprior.simulation.training import (
    Curve,
    as_point,
    executors,
    policy_of,
    report_faults,
    require_sizes,
    training_notes,
)
from motorprior.stage import usable_threads


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
        robot: with legs: a name, the path of a .toml file, or a robot from `load_robot`.
        motors: a prior, a posterior or a fleet to draw from; fixed motors; a function that draws them from a
            generator; or a text such as "pd:kp=9" (`actuator.registry`).
        iterations: maximum, 32 episodes each.
        patience: stop after so many evaluations, one every 10 iterations, without a better policy; never if not given.
        seed: of the search and of the draws; the result does not depend on ``workers``.
        workers: episodes at a time; up to two if not given.
        episode_steps: control steps per episode; see `Walk.episode_steps`.
        gait: see `locomotion.gaits`.
        commands: commanded speeds; see `Commands` for the default.
        randomization: of each episode, in addition to the motors: floor, masses, slope, sensors, pushes.
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
    require_sizes(iterations, episode_steps, workers, hidden_units, patience)
    require_seed(seed)
    if start is not None:
        start.require_robot(robot, "start")
        start.require_gait(gait, "start")
        robot = robot.with_speed_range(start.forward)
    robot = commands.extend_range(robot)
    simulated = simulated_motors(motors, robot)
    for line in training_notes(robot, simulated.prior, validation):
        progress.note(line)
    config, shape = ArsConfig(seed=seed), PolicyShape.of(robot, gait, hidden_units, symmetric)
    walk = WalkConfig(episode_steps, randomization=randomization, commands=commands, gait=gait)
    sources = [motors, *([] if validation is None else [load_robot_fleet(robot, validation)])]
    scenes = [Scene(robot, "mujoco", *motor_sampler(source, robot), walk) for source in sources]
    search, best, curve = new_search(config, shape, start), BestPolicy.none_yet(shape), Curve()
    with (
        executors(scenes, usable_threads(workers, progress)) as (executor, evaluator),
        progress.start(f"train: {iterations} iterations", iterations) as task,
    ):

        def report(point: Iteration, best: BestPolicy) -> None:
            curve.append(as_point(point))
            task.advance(1, f"return {point.mean_return:.2f} m, speed error {point.mean_speed_error:.2f} m/s")

        best = updated_best(search, shape, evaluator, best)  # the initial policy is kept if nothing improves on it
        best = train(search, shape, executor, iterations, best, report, evaluator, patience)
    report_faults(curve, 2 * config.num_directions, progress)
    provenance = {
        "motors": str(type(motors).__name__), "search": asdict(config), "task": asdict(TaskWeights()),
        "iterations": iterations, "patience": patience, "episode_steps": episode_steps, "engine": "mujoco",
        "commands": asdict(commands), "randomization": randomization.as_json(), "symmetric": symmetric,
        "validation": None if validation is None else load_robot_fleet(robot, validation).name,
    }  # fmt: skip
    return policy_of(robot, gait, best, simulated.nominal, provenance)
