"""Robustness maps of a policy, on its training motors."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from motorprior.bounds import require_count
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import description, in_parallel, is_finished, usable_threads, working
from motorprior.pipeline.transfer_study.transfer import trained_walk
from motorprior.pipeline.walking.walk import POLICY
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.transfer.robustness import (
    MAPS,
    ROBUSTNESS_DRAWS,
    Grid,
    UprightMap,
    grids,
    save_maps,
    upright_row,
)
from motorprior.transfer.twin import DURATION_STEPS, straight_ahead


@dataclass(frozen=True)
class Robustness:
    """Robustness maps of a policy."""

    walk: Path
    """Folder of `motorprior walk`."""
    out: Path
    """Folder for the maps."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or a .toml file."""
    workers: int = min(2, os.cpu_count() or 1)
    """Rows of a map at a time; the result does not depend on it."""


def run_robustness(config: Robustness, progress: Progress = SILENT) -> None:
    """Measure the maps of `robustness` unless the folder has them; `load_maps` reads them.

    Raises:
        ArtifactError, ConfigError: an unreadable policy, or missing motors.
    """
    require_count("workers", config.workers)
    robot, path = load_robot(config.robot), config.walk / POLICY
    robot.require_legs()
    settings = asdict(config)
    del settings["workers"]
    wanted = description("robustness", settings, [path, *robot.files])
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            save_maps(config.out / MAPS, robustness(path, robot, config.workers, progress))


def robustness(path: Path, robot: Robot, workers: int = 1, progress: Progress = SILENT) -> tuple[UprightMap, ...]:
    """Walk straight ahead at the policy's maximum speed in every cell of `transfer.robustness.grids`.

    In MuJoCo on flat ground; the result does not depend on ``workers``.

    Args:
        path: the policy's file.
        robot: of the policy.
        workers: rows of a map at a time.
        progress: reports to the user.

    Raises:
        ArtifactError, ConfigError: an unreadable policy, or missing motors.
    """
    robot = robot.with_speeds(Policy.load(path).forward)
    found, name = grids(robot), path.parent.name
    cells = sum(len(grid.rows.values) * len(grid.columns.values) for grid in found)
    with progress.start(f"robustness of {name}: {cells} x {ROBUSTNESS_DRAWS} walks", cells) as task:
        works = [partial(_row, path, robot, grid, value, task) for grid in found for value in grid.rows.values]
        rows = in_parallel(works, usable_threads(workers, progress), progress)
    maps = []
    for grid in found:
        share, rows = np.array(rows[: len(grid.rows.values)]), rows[len(grid.rows.values) :]
        maps.append(UprightMap(grid.rows, grid.columns, share))
    return tuple(maps)


def _row(path: Path, robot: Robot, grid: Grid, value: float, task: Task, _: Progress) -> np.ndarray:
    cells = [
        WalkConfig(DURATION_STEPS, randomization=grid.cell(value, each), commands=straight_ahead(robot))
        for each in grid.columns.values
    ]
    walks = [trained_walk(path, robot, "mujoco", walk) for walk in cells]
    simulators = [each.simulator for each in walks if isinstance(each.simulator, WalkSimulator)]
    return upright_row(walks[0].policy, simulators, task.advance)
