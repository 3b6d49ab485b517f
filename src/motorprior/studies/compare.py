"""Compare policies on sets of motors, as a tidy table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from motorprior.bench.fleet import Fleet
from motorprior.exceptions import ConfigError
from motorprior.locomotion.command import Commands, Range
from motorprior.locomotion.gaits import GaitName
from motorprior.locomotion.policy import Policy
from motorprior.progress import WARNED, Progress
from motorprior.results import Result, Results
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.motors import MotorSource, motor_sampler
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.simulation.world_config import WorldConfig
from motorprior.studies import twin


def compare(
    robot: Robot | str | Path,
    policies: Mapping[str, Policy | Sequence[Policy]],
    twins: Mapping[str, MotorSource],
    *,
    progress: Progress = WARNED,
) -> Results:
    """Evaluate every policy on every set of motors: 24 walks of 5 s, straight ahead at the shared maximum speed.

    Args:
        robot: a legged one; a name, the path of a .toml file, or the result of `load_robot`.
        policies: by training condition; several of one condition are its seeds.
        twins: sets of motors by name. A fleet is evaluated as the held-out twin: unseen motors, physics at the robot's
            ``twin_physics_dt``, encoder noise; other motors as in training.
        progress: reports to the user.

    Returns:
        Rows of speed [m/s], upright (share of the time before a fall) and drift (final, lateral) [m]: means over the
        samples, one row per quantity, policy and set.

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
    gaits: set[tuple[Range, GaitName]] = {(policy.forward, policy.gait) for each in seeds.values() for policy in each}
    commands = twin.straight_ahead(
        twin.with_shared_speeds(robot, (policy for each in seeds.values() for policy in each))
    )
    simulators = {
        (name, *gait): _simulator(robot.with_speed_range(gait[0]), twins[name], gait[1], commands)
        for name in twins
        for gait in gaits
    }
    count = sum(map(len, seeds.values())) * len(twins)
    rows = []
    with progress.start(f"compare: {count} x {twin.DRAWS} walks", twin.DRAWS * count) as task:
        for model, each in seeds.items():
            for motor_set in twins:
                for seed, policy in enumerate(each):
                    simulator = simulators[motor_set, policy.forward, policy.gait]
                    walking, _ = twin.evaluate(robot, policy, simulator, task.advance)
                    for quantity, unit in twin.WALKING_UNITS.items():
                        value = getattr(walking, quantity)
                        rows.append(Result(quantity, unit, value, model=model, motors=motor_set, seed=seed))
    return Results.of(rows)


def _simulator(robot: Robot, motors: MotorSource, gait: GaitName, commands: Commands) -> WalkSimulator:
    if isinstance(motors, Fleet):
        return twin.twin_simulator(robot, motors, gait, commands)
    sample, physics_dt = motor_sampler(motors, robot)
    walk = WalkConfig(twin.DURATION_STEPS, commands=commands, gait=gait)
    return WalkSimulator(sample, WorldConfig.of(robot, physics_dt=physics_dt), walk)
