"""Robustness maps of a policy: time upright over two disturbances at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from motorprior.artifacts import read_json, write_json
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress, Task, in_parallel, usable_threads
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkConfig, WalkSimulator
from motorprior.studies.training_scene import trained_walk
from motorprior.studies.twin import DURATION_STEPS, EVALUATION_SEED, share_upright, straight_ahead

MAPS = "robustness.json"
ROBUSTNESS_DRAWS = 8  # episodes per cell, with the same motors in every cell
FRICTIONS = (0.3, 0.5, 0.75, 1.0)  # [-] of the feet on the ground
PUSHES = (0.0, 0.1, 0.2, 0.4)  # [-] maximum push, once a second, over mass · √(g · standing height)
DELAYS = (0.0, 0.01, 0.02, 0.04)  # [s] of the position targets, in addition to the motors' own
MASSES = (0.8, 1.0, 1.2, 1.4)  # [-] factors on mass and inertia of every link


@dataclass(frozen=True)
class Grid:
    """Two disturbances to vary: titles with units, values, and (row value, column value) -> randomization."""

    titles: tuple[str, str]
    rows: tuple[float, ...]
    columns: tuple[float, ...]
    cell: Callable[[float, float], Randomization]


@dataclass(frozen=True)
class UprightMap:
    """Titles, row values and column values of a `Grid`, and the (rows, columns) share of the time upright [-]."""

    titles: Sequence[str]
    rows: Sequence[float]
    columns: Sequence[float]
    share: Sequence[Sequence[float]]


def save_maps(path: Path, maps: Sequence[UprightMap]) -> None:
    """Write maps as JSON."""
    write_json(path, [asdict(each) for each in maps])


def load_maps(path: Path) -> list[UprightMap]:
    """Read what `save_maps` wrote.

    Raises:
        ArtifactError: missing or damaged.
    """
    return [UprightMap(**each) for each in read_json(path)]


def grids(robot: Robot) -> tuple[Grid, Grid]:
    """Grids of push and friction, and of delay and mass."""
    unit = robot.weight / GRAVITY * math.sqrt(GRAVITY * robot.standing_height)

    def with_push(push: float, friction: float) -> Randomization:
        factor = friction / robot.foot_friction
        return Randomization(push=push, friction=(factor, factor))

    def with_delay(milliseconds: float, mass: float) -> Randomization:
        delay = 1e-3 * milliseconds
        return Randomization(command_delay=(delay, delay), mass=(mass, mass))

    pushes, delays = (float(f"{each * unit:.2g}") for each in PUSHES), (1e3 * each for each in DELAYS)
    return (
        Grid(("maximum push, once a second [N·s]", "friction of the feet [-]"), tuple(pushes), FRICTIONS, with_push),
        Grid(("delay of the targets [ms]", "mass over the nominal one [-]"), tuple(delays), MASSES, with_delay),
    )


def upright_share(policy: Policy, simulator: WalkSimulator) -> float:
    """Mean share of the time upright in ROBUSTNESS_DRAWS episodes of DURATION_STEPS [-]."""
    seeds = range(EVALUATION_SEED, EVALUATION_SEED + ROBUSTNESS_DRAWS)
    episodes = [simulator.run(policy.arrays(), seed) for seed in seeds]
    return float(np.mean([share_upright(episode, DURATION_STEPS) for episode in episodes]))


def robustness(path: Path, robot: Robot, workers: int = 1, progress: Progress = SILENT) -> list[UprightMap]:
    """Walk straight ahead at the policy's maximum speed in every cell of `studies.robustness.grids`.

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
