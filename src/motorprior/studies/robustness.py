"""Robustness maps of a policy: time upright over two disturbances at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from motorprior.locomotion.executor import make_executor
from motorprior.progress import SILENT, Progress
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import WalkConfig
from motorprior.studies.compare import DURATION_STEPS, TrainedPolicy, run_walks, straight_ahead
from motorprior.studies.gait_quality import share_upright

ROBUSTNESS_DRAWS = 8  # episodes per cell, with the same motors in every cell
FRICTIONS = (0.3, 0.5, 0.75, 1.0)  # [-] of the feet on the ground
PUSHES = (0.0, 0.1, 0.2, 0.4)  # [-] maximum push, once a second, over mass · √(g · standing height)
DELAYS = (0.0, 0.01, 0.02, 0.04)  # [s] of the position targets, in addition to the motors' own
MASSES = (0.8, 1.0, 1.2, 1.4)  # [-] factors on mass and inertia of every link


@dataclass(frozen=True)
class UprightMap:
    """Two disturbances: titles with units, values, and the (rows, columns) share of the time upright [-]."""

    titles: Sequence[str]
    rows: Sequence[float]
    columns: Sequence[float]
    share: Sequence[Sequence[float]] = ()


def grids(robot: Robot) -> list[tuple[UprightMap, Callable[[float, float], Randomization]]]:
    """Empty maps of push and friction, and of delay and mass; and (row value, column value) -> randomization."""
    unit = robot.weight / GRAVITY * math.sqrt(GRAVITY * robot.standing_height)

    def with_push(push: float, friction: float) -> Randomization:
        factor = friction / robot.foot_friction
        return Randomization(push=push, friction=(factor, factor))

    def with_delay(milliseconds: float, mass: float) -> Randomization:
        delay = 1e-3 * milliseconds
        return Randomization(command_delay=(delay, delay), mass=(mass, mass))

    pushes, delays = [float(f"{each * unit:.2g}") for each in PUSHES], [1e3 * each for each in DELAYS]
    return [
        (UprightMap(("maximum push, once a second [N·s]", "friction of the feet [-]"), pushes, FRICTIONS), with_push),
        (UprightMap(("delay of the targets [ms]", "mass over the nominal one [-]"), delays, MASSES), with_delay),
    ]


def robustness(trained: TrainedPolicy, workers: int = 1, progress: Progress = SILENT) -> list[UprightMap]:
    """Walk straight ahead at the policy's maximum speed in every cell of `grids`, in MuJoCo on flat ground.

    Args:
        trained: the policy.
        workers: walks at a time; the result does not depend on it.
        progress: reports to the user.

    Raises:
        ArtifactError, ConfigError: its motors cannot be found.
    """
    commands, executor = straight_ahead(trained.robot), partial(make_executor, workers=workers)

    def upright(randomization: Randomization) -> float:
        scene = trained.scene(WalkConfig(DURATION_STEPS, randomization=randomization, commands=commands), "mujoco")
        episodes = run_walks(scene, trained.policy.arrays(), range(ROBUSTNESS_DRAWS), executor=executor)
        task.advance()
        return float(np.mean([share_upright(episode, DURATION_STEPS) for episode in episodes]))

    found = grids(trained.robot)
    cells = sum(len(grid.rows) * len(grid.columns) for grid, _ in found)
    name = f"robustness of {trained.path.parent.name}: {cells} x {ROBUSTNESS_DRAWS} walks"
    with progress.start(name, cells) as task:
        return [
            replace(grid, share=[[upright(cell(row, column)) for column in grid.columns] for row in grid.rows])
            for grid, cell in found
        ]
