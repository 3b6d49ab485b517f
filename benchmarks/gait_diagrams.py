"""Gait diagrams of all gaits, from the trajectory generator itself: docs/gaits.png.

python benchmarks/gait_diagrams.py --out docs/gaits.png
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.locomotion.footfall import planned_stance
from motorprior.locomotion.gaits import GAITS
from motorprior.report.plots_gait import footfalls
from motorprior.report.plots_style import png_bytes
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT

CYCLES = 2.0


@dataclass(frozen=True)
class Diagrams:
    """Draw which foot is on the ground when, two cycles of every gait."""

    out: Path = Path("docs/gaits.png")
    """File of the picture."""
    robot: str = DEFAULT_ROBOT
    """Robot with four legs: a shipped one by name, or the .toml file of your own."""


def draw(settings: Diagrams) -> None:
    """Write the picture."""
    robot = load_robot(settings.robot)
    stances = {gait: planned_stance(robot, gait, CYCLES) for gait in GAITS}
    figure = footfalls(stances, [leg.name for leg in robot.legs], CYCLES, "cycles [-]")
    settings.out.parent.mkdir(parents=True, exist_ok=True)
    settings.out.write_bytes(png_bytes(figure))


if __name__ == "__main__":
    draw(tyro.cli(Diagrams))
