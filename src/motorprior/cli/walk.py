"""``motorprior walk``: train a PMTG policy by ARS on motors drawn for every episode."""

from __future__ import annotations

from dataclasses import dataclass, fields

from motorprior.cli.console import TERMINAL, table
from motorprior.commands.walk import PICTURE, POLICY, SEED_FOLDER, Walk, run_walk, run_walk_seeds
from motorprior.locomotion.policy import Policy
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class WalkCommand(Walk):
    """Train a walking policy."""

    seeds: int = 1
    """Number of trainings, with seeds from search.seed on, each in its own folder seed_K, and a picture of all."""


def walk(config: WalkCommand) -> None:
    """See `run_walk`, and `run_walk_seeds` for several seeds."""
    one = Walk(**{field.name: getattr(config, field.name) for field in fields(Walk)})
    evaluated = "its training simulation" if config.validation is None else f"validation motors ({config.validation})"
    robot = "" if config.robot == DEFAULT_ROBOT else f" --robot {config.robot}"
    if config.seeds == 1:
        if not run_walk(one, TERMINAL):
            TERMINAL.note(f"{config.out} is finished with these settings: nothing was trained")
        best = Policy.load(config.out / POLICY).provenance
        print(f"best policy: iteration {best['iteration']}, mean return {best['own_return']:.2f} m on {evaluated}")
        print(f"play it: motorprior play {config.out}{robot}")
        return
    results = run_walk_seeds(one, config.seeds, TERMINAL)
    rows = [(str(row.seed), f"{row.value:.2f}") for row in results]
    table(f"Best policies on {evaluated}", ("seed", "mean return [m]"), rows)
    print(config.out / PICTURE)
    best_seed = max(results, key=lambda row: row.value).seed
    print(f"play the best: motorprior play {config.out / SEED_FOLDER.format(best_seed)}{robot}")
