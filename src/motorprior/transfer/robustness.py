"""Robustness maps of a policy: time upright over two disturbances at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.exceptions import ArtifactError
from motorprior.locomotion.policy import Policy
from motorprior.robots.robot import GRAVITY, Robot
from motorprior.schema import TEXT, Schema, many
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.rollout import WalkSimulator
from motorprior.transfer.twin import DURATION_STEPS, EVALUATION_SEED, share_upright

MAPS = "robustness.safetensors"
_REMEDY = "delete it and measure it again"
_HEADER = Schema({"titles": many(many(TEXT, 2), 1)}, _REMEDY)
ROBUSTNESS_DRAWS = 8  # episodes per cell, with the same motors in every cell
FRICTIONS = (0.3, 0.5, 0.75, 1.0)  # [-] of the feet on the ground
PUSHES = (0.0, 0.1, 0.2, 0.4)  # [-] maximum push, once a second, over mass · √(g · standing height)
DELAYS = (0.0, 0.01, 0.02, 0.04)  # [s] of the position targets, besides the motors' own
MASSES = (0.8, 1.0, 1.2, 1.4)  # [-] factors on mass and inertia of every link


@dataclass(frozen=True)
class Scale:
    """Attributes: title, quantity with its unit; values, in that unit."""

    title: str
    values: tuple[float, ...]


@dataclass(frozen=True)
class Grid:
    """A disturbance per row and one per column.

    Attributes:
        rows: values of the first.
        columns: values of the second.
        cell: (row value, column value) -> randomization of the episodes.
    """

    rows: Scale
    columns: Scale
    cell: Callable[[float, float], Randomization]


@dataclass(frozen=True, eq=False)
class UprightMap:
    """Attributes: rows and columns, see `Grid`; share (rows, columns) of the time upright [-]."""

    rows: Scale
    columns: Scale
    share: np.ndarray


def save_maps(path: Path, maps: Sequence[UprightMap]) -> None:
    """Write maps as a file of tensors, N/rows, N/columns and N/share, with the axis titles in its header."""
    tensors: dict[str, np.ndarray] = {}
    for number, each in enumerate(maps):
        found = {"rows": np.array(each.rows.values), "columns": np.array(each.columns.values), "share": each.share}
        tensors |= {f"{number}/{name}": value for name, value in found.items()}
    write_tensors(path, tensors, {"titles": [[each.rows.title, each.columns.title] for each in maps]})


def load_maps(path: Path) -> tuple[UprightMap, ...]:
    """Read what `save_maps` wrote.

    Raises:
        ArtifactError: missing or damaged.
    """
    tensors, header = read_tensors(path, _HEADER.check)
    return tuple(_map(tensors, number, titles, path) for number, titles in enumerate(header["titles"]))


def _map(tensors: dict[str, np.ndarray], number: int, titles: list[str], path: Path) -> UprightMap:
    rows, columns, share = (tensors.get(f"{number}/{name}", np.zeros(())) for name in ("rows", "columns", "share"))
    if len(titles) != 2 or rows.ndim != 1 or columns.ndim != 1 or share.shape != (*rows.shape, *columns.shape):
        problem = f"map {number} has shape {share.shape}, its {len(titles)} axes {rows.shape} and {columns.shape}"
        raise ArtifactError(problem, where=path, remedy=_REMEDY)
    row, column = titles
    return UprightMap(Scale(row, tuple(rows.tolist())), Scale(column, tuple(columns.tolist())), share)


def grids(robot: Robot) -> tuple[Grid, Grid]:
    """Push over friction, and delay over mass."""
    unit = robot.weight / GRAVITY * math.sqrt(GRAVITY * robot.standing_height)
    pushes = Scale("maximum push, once a second [N·s]", tuple(float(f"{each * unit:.2g}") for each in PUSHES))
    friction = Scale("friction of the feet [-]", FRICTIONS)
    delays = Scale("delay of the targets [ms]", tuple(1e3 * each for each in DELAYS))

    def with_push(push: float, value: float) -> Randomization:
        factor = value / robot.foot_friction
        return Randomization(push=push, friction=(factor, factor))

    def with_delay(milliseconds: float, mass: float) -> Randomization:
        delay = 1e-3 * milliseconds
        return Randomization(command_delay=(delay, delay), mass=(mass, mass))

    return Grid(pushes, friction, with_push), Grid(delays, Scale("mass over the nominal one [-]", MASSES), with_delay)


def upright_row(
    policy: Policy, simulators: Sequence[WalkSimulator], progress: Callable[[], None] = lambda: None
) -> np.ndarray:
    """(simulators,) mean share of the time upright of ROBUSTNESS_DRAWS episodes of DURATION_STEPS in each [-].

    Args:
        policy: to evaluate.
        simulators: one per cell of a row.
        progress: called after every cell.
    """
    shares = []
    for simulator in simulators:
        seeds = range(EVALUATION_SEED, EVALUATION_SEED + ROBUSTNESS_DRAWS)
        episodes = [simulator.run(policy.arrays(), seed) for seed in seeds]
        shares.append(float(np.mean([share_upright(episode, DURATION_STEPS) for episode in episodes])))
        progress()
    return np.array(shares)
