"""``motorprior play``: policies as a film, with measures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.commands.play import Play, run_play
from motorprior.results import Results


@dataclass(frozen=True)
class PlayCommand(Play):
    """Render policies as a film and measure how well they walk; several are shown one below the other."""

    policies: tyro.conf.Positional[tuple[Path, ...]]


def play(config: PlayCommand) -> None:
    """See `run_play`; prints the measures and the path of the film."""
    played = run_play(config, TERMINAL)
    _show_measures(played.results)
    print(played.film)


def _show_measures(results: Results) -> None:
    """A row per measure, a column per policy."""
    names, rows = results.distinct("model"), []
    for quantity, unit, part in dict.fromkeys((row.quantity, row.unit, row.part) for row in results):
        title = " ".join(filter(None, (quantity, part))) + ("" if unit == "1" else f" [{unit}]")
        cells = []
        for name in names:
            found = results.where(quantity=quantity, part=part, model=name)
            cells.append(f"{found.rows[0].value:.3g}" if found else "-")
        rows.append((title, *cells))
    table("From the first second on (docs/play.md)", ("measure", *names), rows)
