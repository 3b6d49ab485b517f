"""Policies against motors they were not trained on, as a tidy table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from motorprior.bench.fleet import Fleet
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands, Range
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorSource, motor_sampler
from motorprior.pipeline.progress import WARNED, Progress
from motorprior.results import Result, Results
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world_config import WorldConfig
from motorprior.transfer.study import DRAWS, evaluate
from motorprior.transfer.twin import DURATION_STEPS, straight_ahead, together, twin_simulator

_UNITS = {"speed": "m/s", "upright": "1", "drift": "m"}


def compare(
    robot: Robot | str | Path,
    policies: Mapping[str, Policy | Sequence[Policy]],
    twins: Mapping[str, MotorSource],
    *,
    progress: Progress = WARNED,
) -> Results:
    """Walk every policy on every set of motors, 24 draws of 5 s each, straight ahead as fast as all may be told.

    Args:
        robot: a legged one; a name, the path of a .toml file, or what `load_robot` gave.
        policies: by the name of what they were trained on; several of one name are its seeds.
        twins: sets of motors by name. A fleet is the held-out twin: motors that no bench and no training draws, physics
            at the robot's ``twin_physics_dt``, noisy encoders. Anything else is simulated as in training.
        progress: where to report to.

    Returns:
        Rows of speed [m/s], upright (share of the time before a fall) and drift (sideways, at the end) [m]: means over
        the draws, one row per quantity, policy and set.

    Raises:
        ConfigError: no policy, no motors, a robot without legs, or policies or motors that do not fit it.
        ArtifactError: a robot that cannot be read.
    """
    robot = as_robot(robot)
    robot.require_legs()
    seeds = {name: [each] if isinstance(each, Policy) else list(each) for name, each in policies.items()}
    for name, value in (("policies", policies), ("twins", twins)):
        if not value:
            raise ConfigError(f"no {name} given", remedy="give at least one by name", argument=name)
    for name, each in seeds.items():
        for policy in each:
            policy.require_robot(robot, name)
            policy.require_clock(robot.control_dt, name)
    ways: set[tuple[Range, GaitName]] = {(policy.forward, policy.gait) for each in seeds.values() for policy in each}
    commands = straight_ahead(together(robot, (policy for each in seeds.values() for policy in each)))
    simulators = {
        (name, *way): _simulator(robot.told(way[0]), twins[name], way[1], commands) for name in twins for way in ways
    }
    count = sum(map(len, seeds.values())) * len(twins)
    rows = []
    with progress.start(f"compare: {count} x {DRAWS} draws", DRAWS * count) as task:
        for model, each in seeds.items():
            for motor_set in twins:
                for seed, policy in enumerate(each):
                    there = simulators[motor_set, policy.forward, policy.gait]
                    walking, _ = evaluate(robot, policy, there, task.advance)
                    for quantity, unit in _UNITS.items():
                        value = getattr(walking, quantity)
                        rows.append(Result(quantity, unit, value, model=model, motors=motor_set, seed=seed))
    return Results.of(rows)


def _simulator(robot: Robot, motors: MotorSource, gait: GaitName, commands: Commands) -> WalkSimulator:
    if isinstance(motors, Fleet):
        return twin_simulator(robot, motors, gait, commands)
    draw, physics_dt = motor_sampler(motors, robot)
    walk = WalkConfig(DURATION_STEPS, commands=commands, gait=gait)
    return WalkSimulator(draw, WorldConfig.of(robot, physics_dt=physics_dt), walk)
