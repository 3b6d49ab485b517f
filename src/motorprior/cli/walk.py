"""``motorprior walk``: ARS trains a PMTG policy on motors drawn again for every episode."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.walking.walk import POLICY, Walk, run_walk
from motorprior.pipeline.walking.walk_seeds import PICTURE, SEED_FOLDER, run_walk_seeds
from motorprior.robots.shipped import DEFAULT_ROBOT


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
        print(_kept(config))
        return
    results = run_walk_seeds(one, config.seeds, TERMINAL)
    rows = [(str(row.seed), f"{row.value:.2f}") for row in results]
    table(f"Best policies {_judged_on(config, 'their')}", ("seed", "mean return [m]"), rows)
    print(config.out / PICTURE)
    best = max(results, key=lambda row: row.value).seed
    print(f"see the best one walk: {_play(config, config.out / SEED_FOLDER.format(best))}")


def _kept(config: WalkCommand) -> str:
    """Which policy of the search is in the folder, and how to see it walk."""
    found = Policy.load(config.out / POLICY).provenance
    score = f"mean return {found['own_return']:.2f} m {_judged_on(config, 'its')}"
    return f"kept the policy after iteration {found['iteration']}, {score}; see it walk: {_play(config, config.out)}"


def _play(config: WalkCommand, folder: Path) -> str:
    """What shows the policy in a folder."""
    return f"motorprior play {folder}" + (f" --robot {config.robot}" if config.robot != DEFAULT_ROBOT else "")


def _judged_on(config: WalkCommand, whose: str) -> str:
    """Where it is decided which policy of a search is kept."""
    if config.validation is None:
        return f"in {whose} own simulation"
    return f"on validation motors ({config.validation})"
