"""Robustness maps of a policy, on its training motors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import cast

from motorprior.bounds import require_count
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import description, in_parallel, is_finished, usable_threads, working
from motorprior.pipeline.transfer_study.transfer import trained_walk
from motorprior.pipeline.walking.walk import POLICY
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.transfer.robustness import MAPS, ROBUSTNESS_DRAWS, Grid, UprightMap, grids, save_maps, upright_share
from motorprior.transfer.twin import DURATION_STEPS, straight_ahead


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


def robustness(path: Path, robot: Robot, workers: int = 1, progress: Progress = SILENT) -> list[UprightMap]:
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
    robot = robot.with_speed_range(Policy.load(path).forward)
    found = grids(robot)
    cells = sum(len(grid.rows) * len(grid.columns) for grid in found)
    with progress.start(f"robustness of {path.parent.name}: {cells} x {ROBUSTNESS_DRAWS} walks", cells) as task:
        works = [partial(_row, path, robot, grid, value, task) for grid in found for value in grid.rows]
        shares = iter(in_parallel(works, usable_threads(workers, progress), progress))
    return [UprightMap(grid.titles, grid.rows, grid.columns, [next(shares) for _ in grid.rows]) for grid in found]


def _row(path: Path, robot: Robot, grid: Grid, value: float, task: Task, _: Progress) -> list[float]:
    shares = []
    for column in grid.columns:
        walk = WalkConfig(DURATION_STEPS, randomization=grid.cell(value, column), commands=straight_ahead(robot))
        trained = trained_walk(path, robot, "mujoco", walk)
        shares.append(upright_share(trained.policy, cast(WalkSimulator, trained.simulator)))
        task.advance()
    return shares
