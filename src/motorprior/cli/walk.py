"""``motorprior walk``: ARS trains a PMTG policy on motors drawn again for every episode."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from motorprior.cli.console import TERMINAL
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walk import Walk, run_walk


@dataclass(frozen=True)
class WalkCommand(Walk):
    """Train a walking policy."""

    motors: Annotated[MotorChoice, tyro.conf.arg(name="")] = field(default_factory=MotorChoice)


def walk(config: WalkCommand) -> None:
    """See `run_walk`."""
    run_walk(config, TERMINAL)
