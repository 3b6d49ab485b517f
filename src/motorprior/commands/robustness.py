"""Robustness maps of a policy, on its training motors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from motorprior.bounds import require_count
from motorprior.commands.walk import POLICY
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.stage import description, is_finished, working
from motorprior.studies.robustness import (
    MAPS,
    robustness,
    save_maps,
)


@dataclass(frozen=True)
class Robustness:
    """Robustness maps of a policy: folder of `motorprior walk`, folder for the maps, robot, rows at a time."""

    walk: Path
    out: Path
    robot: str
    workers: int = 1


def run_robustness(config: Robustness, progress: Progress = SILENT) -> None:
    """Measure the maps of `robustness` unless the folder has them; `load_maps` reads them.

    Raises:
        ArtifactError, ConfigError: an unreadable policy, or missing motors.
    """
    require_count("workers", config.workers)
    robot, path = load_robot(config.robot), config.walk / POLICY
    wanted = description("robustness", {"robot": config.robot, "file": MAPS}, [path, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            save_maps(config.out / MAPS, robustness(path, robot, config.workers, progress))
