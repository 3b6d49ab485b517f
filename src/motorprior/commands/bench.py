"""Motor logs of physical motors on a virtual dynamometer."""

from dataclasses import asdict, dataclass
from pathlib import Path

from motorprior.bench.bench_folder import record_bench
from motorprior.progress import SILENT, Progress
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Bench:
    """Record motor logs on a virtual dynamometer."""

    out: Path
    """Folder for log.parquet and bench.json."""
    fleet: str | None = None
    """Population of motors: name of a shipped fleet, or a .toml file; the robot's fleet if not
    given."""
    preset: str = "rollout"
    """Excitation and sample period: rollout (sinusoids, steps, gaits, impacts; 2 ms), adapt (as
    rollout, but shorter), narrow (sinusoids on one load; 2 ms) or paper (sinusoids on one load;
    10 ms)."""
    motors: int = 32
    """Number of motors sampled from the fleet."""
    steps: int = 10_000
    """Samples per motor."""
    seed: int = 0
    """Seed of the motors and their excitation."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""
    excitation: str | None = None
    """Excitation of every segment in place of the preset's: the name of a signal, such as steps, or
    a file of `motorprior excite`, which also gives the loads."""


def run_bench(config: Bench, progress: Progress = SILENT) -> None:
    """Record, unless the stage is finished; errors as `record_bench`."""
    record_bench(**asdict(config), progress=progress)
