"""Motor logs of physical motors of a fleet on a virtual dynamometer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from motorprior.bench.bench_folder import require_bench_size, training_motors
from motorprior.bench.fleet import Fleet, load_robot_fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import require_seed
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


def record_bench(
    robot: Robot | str | Path = DEFAULT_ROBOT,
    fleet: Fleet | str | Path | None = None,
    *,
    motors: int = 32,
    steps: int = 10_000,
    preset: str = "rollout",
    seed: int = 0,
) -> MotorLog:
    """Record physical motors of a fleet on a virtual dynamometer.

    Args:
        robot: for the loads of the motors; a name, the path of a .toml file, or the result of `load_robot`.
        fleet: population of the motors; the robot's own if not given.
        motors: number of motors.
        steps: samples per motor.
        preset: excitation: rollout (sinusoids, steps, gaits, impacts, 2 ms), adapt (the same, in short), narrow
            (sinusoids on one load, 2 ms), paper (sinusoids on one load, 10 ms).
        seed: draws the motors and their excitation; same arguments, same bytes.

    Returns:
        A log of joints motor_000, motor_001, … with torques and loads.

    Raises:
        ConfigError: a number out of range, an unknown preset, or a fleet of another robot.
        ArtifactError: a robot or a fleet that cannot be read.
    """
    require_bench_size(motors, steps)
    require_seed(seed)
    robot = as_robot(robot)
    population, excitation = load_robot_fleet(robot, fleet), bench_preset(preset).for_robot(robot)
    log = record(training_motors(population, motors, seed), excitation, steps, seed, population)
    return replace(log, robot=population.robot)  # no bench.json names it
