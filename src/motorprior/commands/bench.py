"""Motor logs of physical motors on a virtual dynamometer."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from motorprior.artifacts import write_json
from motorprior.bench.bench_folder import BENCH_JSON, LOG, BenchSettings
from motorprior.bench.fleet import fleet_files, load_robot_fleet
from motorprior.bench.recording import bench_preset, record, training_motors
from motorprior.bounds import require_count, require_seed
from motorprior.logs.readers.motor_log_file import write_log
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working


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
    """Seed of the motors and their excitation."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    excitation: Path | None = None
    """Play this file of `motorprior excite` in every segment, on its loads; otherwise the preset's excitation."""


def run_bench(config: Bench, progress: Progress = SILENT) -> None:
    """Record, unless the stage is finished; errors for a setting, fleet or folder that cannot be used."""
    require_count("motors", config.motors)
    require_count("steps", config.steps, 2)
    require_seed(config.seed)
    robot = load_robot(config.robot)
    fleet, preset = load_robot_fleet(robot, config.fleet), bench_preset(config.preset).for_robot(robot)
    preset, played = preset.with_excitation(config.excitation), [config.excitation] if config.excitation else []
    wanted = description(
        "bench", asdict(config), [*fleet_files(robot, config.fleet), *robot.files, *played], recipe=asdict(preset)
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
