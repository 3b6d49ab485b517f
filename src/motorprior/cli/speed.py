"""``motorprior speed``: the rollout kernel against the bare physics engine, and against slower ways."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from motorprior.artifacts import atomic_path, json_text
from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.speed import measure_speed
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.timed_paths import REPEATS


@dataclass(frozen=True)
class Speed:
    """Time whole episodes: compiled, interpreted, in PyBullet, on two threads, beside mj_step alone."""

    prior: Path
    """Prior whose motors are timed (any preset)."""
    fleet: str | None = None
    """Fleet of the physical motors and of the PD's gains; the robot's own if not given."""
    json: Path | None = None
    """File for the figures."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own."""


def run_speed(config: Speed) -> None:
    """Measure and print.

    Raises:
        ArtifactError: the file cannot be written: said before anything is measured.
    """
    with ExitStack() as stack:
        file = None if config.json is None else stack.enter_context(atomic_path(config.json))
        results = measure_speed(
            config.prior, load_robot(config.robot), config.fleet, interpreted=True, progress=TERMINAL
        )
        if file is not None:
            file.write_text(json_text(results.to_figures()), encoding="utf-8")
    rows = [[name, f"{value:,.3f}" if value < 100 else f"{value:,.0f}"] for name, value in results.to_figures().items()]
    table(f"Speed per core, medians of {REPEATS} interleaved runs", ["path", "value"], rows)
