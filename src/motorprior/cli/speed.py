"""``motorprior speed``: the rollout kernel against the bare physics engine."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.physical import LONGEST_STEP, PhysicalActuator
from motorprior.artifacts import write_json
from motorprior.cli.console import bar, table
from motorprior.cli.motors import load_prior, load_robot_fleet
from motorprior.cli.validate import nominal_pd
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.speed import measure


@dataclass(frozen=True)
class Speed:
    """Time whole episodes with every kind of motor, beside mj_step alone on the same torques."""

    prior: Path
    """Prior whose motors are timed (any preset)."""
    fleet: str = "pupper_v2"
    """Fleet of the physical motors and of the PD's gains."""
    json: Path | None = None
    """File for the figures."""


def measure_speed(prior_path: Path, fleet_name: str) -> dict[str, float]:
    """The figures of `simulation.speed.measure`, for one core."""
    prior, fleet = load_prior(prior_path), load_robot_fleet(fleet_name)
    actuators: dict[str, tuple[Actuator, float]] = {
        "ideal_pd": (nominal_pd(fleet, spec.NUM_JOINTS), spec.PHYSICS_DT),
        "rollout": (prior.sample(np.random.default_rng(0), spec.NUM_JOINTS), spec.PHYSICS_DT),
        "physical": (PhysicalActuator(fleet.center(spec.NUM_JOINTS)), LONGEST_STEP),
    }
    with bar("speed: episodes side by side", 1) as progress:
        figures = measure(actuators)
        progress.advance()
    return figures


def run_speed(config: Speed) -> None:
    """Measure and print."""
    figures = measure_speed(config.prior, config.fleet)
    rows = [[name, f"{value:,.3f}" if value < 100 else f"{value:,.0f}"] for name, value in figures.items()]
    table("Speed, one core, medians of 7 interleaved runs", ["path", "value"], rows)
    if config.json is not None:
        write_json(config.json, figures)
