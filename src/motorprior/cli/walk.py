"""``motorprior walk``: ARS trains a PMTG policy on motors drawn again for every episode."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Annotated

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.walk import Walk, run_walk
from motorprior.pipeline.walking.walk_seeds import PICTURE, run_walk_seeds


@dataclass(frozen=True)
class WalkCommand(Walk):
    """Train a walking policy."""

    motors: Annotated[MotorChoice, tyro.conf.arg(name="")] = field(default_factory=MotorChoice)
    seeds: int = 1
    """Number of trainings, with seeds from search.seed on, each in a folder seed_K of its own, and a picture of all."""


def walk(config: WalkCommand) -> None:
    """See `run_walk`, and `run_walk_seeds` for more seeds than one."""
    one = Walk(**{name: getattr(config, name) for name in (field.name for field in fields(Walk))})
    if config.seeds == 1:
        if not run_walk(one, TERMINAL):
            TERMINAL.note(f"{config.out} is finished with these settings: nothing was trained")
        return
    results = run_walk_seeds(one, config.seeds, TERMINAL)
    rows = [(str(row.seed), f"{row.value:.2f}") for row in results]
    where = "in their own simulation" if config.validation is None else f"on validation motors ({config.validation})"
    table(f"Best policies {where}", ("seed", "mean return [m]"), rows)
    print(config.out / PICTURE)
