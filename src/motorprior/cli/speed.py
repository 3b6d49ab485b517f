"""``motorprior speed``: the rollout kernel against the bare physics engine, and against slower ways."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from motorprior.artifacts import atomic_path, json_text
from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.speed import measure_speed
from motorprior.simulation.speed import REPEATS


@dataclass(frozen=True)
class Speed:
    """Time whole episodes: compiled, interpreted, in PyBullet, on two threads, beside mj_step alone."""

    prior: Path
    """Prior whose motors are timed (any preset)."""
    fleet: str = "pupper_v2"
    """Fleet of the physical motors and of the PD's gains."""
    json: Path | None = None
    """File for the figures."""


def run_speed(config: Speed) -> None:
    """Measure and print.

    Raises:
        ArtifactError: the file cannot be written: said before anything is measured.
    """
    with ExitStack() as stack:
        file = None if config.json is None else stack.enter_context(atomic_path(config.json))
        figures = measure_speed(config.prior, config.fleet, interpreted=True, progress=TERMINAL)
        if file is not None:
            file.write_text(json_text(figures), encoding="utf-8")
    rows = [[name, f"{value:,.3f}" if value < 100 else f"{value:,.0f}"] for name, value in figures.items()]
    table(f"Speed per core, medians of {REPEATS} interleaved runs", ["path", "value"], rows)
