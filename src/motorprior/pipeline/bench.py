"""Motor logs of physical motors on a virtual dynamometer."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

from motorprior.artifacts import write_json
from motorprior.bench.bench_folder import BENCH_JSON, LOG, BenchSettings, require_bench_size, training_motors
from motorprior.bench.fleet import Fleet
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import require_seed
from motorprior.logs.formats.parquet_io import write_log
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.stage import description, fleet_files, is_finished, working
from motorprior.robots.load import as_robot, load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Bench:
    """Record motor logs on a virtual dynamometer."""

    out: Path
    """Folder for log.parquet and bench.json."""
    fleet: str | None = None
    """Population of motors: a shipped one by name, or a .toml file; the robot's own if not given."""
    preset: str = "rollout"
    """Excitation: rollout (sinusoids, steps, gaits, impacts; 2 ms), adapt (the same, in short), narrow (sinusoids on
    one load; 2 ms) or paper (sinusoids on one load; 10 ms)."""
    motors: int = 32
    """Number of motors drawn from the fleet."""
    steps: int = 10_000
    """Samples per motor."""
    seed: int = 0
    """Draws the motors and their excitation."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


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


def run_bench(config: Bench, progress: Progress = SILENT) -> None:
    """Record, unless the stage is finished.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a fleet or folder that cannot be used.
    """
    require_bench_size(config.motors, config.steps)
    require_seed(config.seed)
    robot = load_robot(config.robot)
    fleet, preset = load_robot_fleet(robot, config.fleet), bench_preset(config.preset).for_robot(robot)
    wanted = description(
        "bench", asdict(config), [*fleet_files(robot, config.fleet), *robot.files], recipe=asdict(preset)
    )
    if is_finished(config.out, wanted):
        return
    title = f"bench {config.preset}: {config.motors} motors, {config.steps} steps"
    with working(config.out, wanted), progress.start(title, 1) as task:
        (config.out / BENCH_JSON).unlink(missing_ok=True)  # it may be of other motors
        motors = training_motors(fleet, config.motors, config.seed)
        write_log(config.out / LOG, record(motors, preset, config.steps, config.seed, fleet))
        settings = BenchSettings(fleet, config.preset, config.motors, config.steps, config.seed)
        write_json(config.out / BENCH_JSON, settings.as_json())
        task.advance()
