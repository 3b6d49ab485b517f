"""Figures of a benchmark: computed once, written as JSON, printed, set in tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from motorprior.artifacts import read_json, write_json
from motorprior.stage import FIGURES, is_finished, working


def measured(folder: Path, wanted: dict[str, Any], compute: Callable[[], Any]) -> Any:
    """The figures of a stage with the `description` ``wanted``; computed if its folder does not have them."""
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            write_json(folder / FIGURES, compute())
    return read_json(folder / FIGURES)


def report(found: Mapping[str, float], path: Path | None) -> None:
    """Print the figures, and write them to a file if given."""
    print("\n".join(f"{name:40} {value:12.6g}" for name, value in found.items()))
    if path is not None:
        write_json(path, found)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:]])
