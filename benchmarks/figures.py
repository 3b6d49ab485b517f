"""What benchmarks share: settings from the command line, figures as JSON and tables, recordings."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tyro

import motorprior as mp
from motorprior.artifacts import write_json
from motorprior.progress import Lines
from motorprior.stage import FIGURES

PROGRESS = Lines()


def run_benchmark(
    settings: type[Any], compute: Callable[[Any], Mapping[str, float]], text: str | None
) -> None:
    """Compute figures with ``settings`` from the command line.

    The figures are printed and written to the folder ``out`` of the settings.
    """
    values = tyro.cli(settings, description=text)
    report(compute(values), values.out / FIGURES)


def report(figures: Mapping[str, float], path: Path | None) -> None:
    """Print the figures, and write them to a file if given."""
    for name, value in figures.items():
        print(f"{name:40} {value:12.6g}")
    if path is not None:
        write_json(path, figures)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    lines += [f"| {' | '.join(cells)} |" for cells in rows]
    return "\n".join(lines)


def import_log(raw: Path, path: Path, columns: str | Path | None, robot: str | Path | None) -> None:
    """Write the motor log of a recording; ``robot``, if any, is suspended or has a fixed base.

    Errors that the log doctor finds are reported and do not stop the import: benchmarks take public
    recordings as they are.
    """
    log = mp.load_log(
        raw,
        columns=columns,
        robot=robot,
        suspended=robot is not None,
        progress=PROGRESS,
        allow_errors=True,
    )
    mp.write_log(path, log)
