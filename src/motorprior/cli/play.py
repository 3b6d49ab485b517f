"""``motorprior play``: policies as a film, with measures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.commands.play import Play, run_play


@dataclass(frozen=True)
class PlayCommand(Play):
    """Render policies as a film and measure how well they walk; several are shown one below the other."""

    policies: tyro.conf.Positional[tuple[Path, ...]]


def play(config: PlayCommand) -> None:
    """See `run_play`; prints the measures and the path of the film."""
    played = run_play(config, TERMINAL)
    names, rows = played.results.distinct("model"), []
    for quantity, unit, part in dict.fromkeys((row.quantity, row.unit, row.part) for row in played.results):
        title = " ".join(filter(None, (quantity, part))) + ("" if unit == "1" else f" [{unit}]")
        found = [played.results.where(quantity=quantity, part=part, model=name) for name in names]
        rows.append((title, *(f"{each.rows[0].value:.3g}" if each else "-" for each in found)))
    table("From the first second on (docs/play.md)", ("measure", *names), rows)
    print(played.film)
