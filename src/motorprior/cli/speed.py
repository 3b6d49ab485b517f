"""``motorprior speed``: the rollout kernel against the bare physics engine, and against slower ways."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.physical import LONGEST_STEP, PhysicalActuator
from motorprior.artifacts import atomic_path, json_text
from motorprior.cli.console import bar, table
from motorprior.cli.motors import load_prior, load_robot_fleet
from motorprior.cli.validate import nominal_pd
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.speed import REPEATS, compiled_paths, interpreted_paths, measure


@dataclass(frozen=True)
class Speed:
    """Time whole episodes: compiled, interpreted, in PyBullet, on two threads, beside mj_step alone."""

    prior: Path
    """Prior whose motors are timed (any preset)."""
    fleet: str = "pupper_v2"
    """Fleet of the physical motors and of the PD's gains."""
    json: Path | None = None
    """File for the figures."""


def measure_speed(prior_path: Path, fleet_name: str, interpreted: bool = False) -> dict[str, float]:
    """The figures of `simulation.speed.measure`.

    Args:
        prior_path: of the learned motors.
        fleet_name: of the physical ones.
        interpreted: measure the paths with the interpreter in the loop too.
    """
    prior, fleet = load_prior(prior_path), load_robot_fleet(fleet_name)
    learned = prior.sample(np.random.default_rng(0), spec.NUM_JOINTS)
    actuators: dict[str, tuple[Actuator, float]] = {
        "ideal_pd": (nominal_pd(fleet, spec.NUM_JOINTS), spec.PHYSICS_DT),
        "rollout": (learned, spec.PHYSICS_DT),
        "physical": (PhysicalActuator(fleet.center(spec.NUM_JOINTS)), LONGEST_STEP),
    }
    with bar("speed: episodes side by side", REPEATS) as progress, ExitStack() as stack:
        paths = compiled_paths(actuators) | (interpreted_paths(learned) if interpreted else {})
        for path in paths.values():
            stack.callback(path.close)
        return measure(paths, progress=progress.advance)


def run_speed(config: Speed) -> None:
    """Measure and print.

    Raises:
        ArtifactError: the file cannot be written: said before anything is measured.
    """
    with ExitStack() as stack:
        file = None if config.json is None else stack.enter_context(atomic_path(config.json))
        figures = measure_speed(config.prior, config.fleet, interpreted=True)
        if file is not None:
            file.write_text(json_text(figures), encoding="utf-8")
    rows = [[name, f"{value:,.3f}" if value < 100 else f"{value:,.0f}"] for name, value in figures.items()]
    table(f"Speed per core, medians of {REPEATS} interleaved runs", ["path", "value"], rows)
