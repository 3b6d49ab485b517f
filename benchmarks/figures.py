"""Run a benchmark; its figures are written as JSON, printed, and set in tables."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tyro

from motorprior.artifacts import write_json
from motorprior.progress import Lines
from motorprior.stage import FIGURES

PROGRESS = Lines()


def run_benchmark(
    settings: type[Any], measure: Callable[[Any], Mapping[str, float]], text: str | None
) -> None:
    """Measure with ``settings`` from the command line, print the figures, and write them to their folder ``out``."""
    given = tyro.cli(settings, description=text)
    report(measure(given), given.out / FIGURES)


def report(found: Mapping[str, float], path: Path | None) -> None:
    """Print the figures, and write them to a file if given."""
    print("\n".join(f"{name:40} {value:12.6g}" for name, value in found.items()))
    if path is not None:
        write_json(path, found)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])
