"""Gait diagrams of all gaits, from the trajectory generator: docs/gaits.png.

python benchmarks/gait_diagrams.py --out docs/gaits.png
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from motorprior.locomotion.body import GAITS, body_of
from motorprior.locomotion.trajectory_generator import foot_path
from motorprior.report.plots_style import png_bytes
from motorprior.report.plots_walk import footfalls
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT

CYCLES = 2.0


@dataclass(frozen=True)
class Diagrams:
    """Draw the stance phases of all feet in two cycles of every gait."""

    out: Path = Path("docs/gaits.png")  # file of the picture
    robot: str = DEFAULT_ROBOT  # robot with four legs: a shipped one by name, or a .toml file


def planned_stance(robot: Robot, gait: str, samples: int = 1000) -> np.ndarray:
    """(CYCLES · samples, legs) planned ground contact of each foot: zero lift in the trajectory generator."""
    body = body_of(robot, gait)
    stance_share = 1.0 / (1.0 + body.swing_stance_ratio)
    phases = (np.arange(round(CYCLES * samples))[:, None] / samples + body.phases) % 1.0
    return np.array([[foot_path(phase, stance_share)[1] <= 0.0 for phase in row] for row in phases])


def draw(settings: Diagrams) -> None:
    """Write the picture."""
    robot = load_robot(settings.robot)
    stances = {gait: planned_stance(robot, gait) for gait in GAITS}
    figure = footfalls(stances, [leg.name for leg in robot.legs], CYCLES, "cycles [-]")
    settings.out.parent.mkdir(parents=True, exist_ok=True)
    settings.out.write_bytes(png_bytes(figure))


if __name__ == "__main__":
    draw(tyro.cli(Diagrams))
