"""Closed-loop fidelity of motor priors, compared with the physical motors that they learned from."""

from dataclasses import asdict, dataclass
from pathlib import Path

from motorprior.progress import SILENT, Progress
from motorprior.results import Results
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.studies.bench_validation import ADAPT_SECONDS, validate_on_bench


@dataclass(frozen=True)
class Validate:
    """Compare priors with the physical motors of a bench, and with held-out motors."""

    priors: tuple[Path, ...]
    """Prior files that `motorprior identify` wrote, all from benches of the same motors."""
    out: Path
    """Folder for figures.json."""
    seed: int = 0
    """Seed of the held-out excitation."""
    adapt_seconds: tuple[float, ...] = ADAPT_SECONDS
    """Lengths of log [s] to which the prior is adapted for held-out motors."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_validate(config: Validate, progress: Progress = SILENT) -> Results:
    """Measure, or read the results of the finished stage; errors as `validate_on_bench`."""
    return validate_on_bench(**asdict(config), progress=progress)
