"""Terminal output: progress, notes and tables."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from motorprior.progress import Lines

CONSOLE = Console(stderr=True, highlight=False)
TERMINAL = Lines()


def command_line() -> str:
    """The command line of this process, without options on which no result depends."""
    words = ["motorprior", *sys.argv[1:]]
    for option in ("--out", "--workers"):
        if option in words:
            del words[(at := words.index(option)) : at + 2]
    return shlex.join(word for word in words if not word.startswith(("--out=", "--workers=")))


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; the first column is text, the others are numbers."""
    printed = Table(title=Text(title), title_justify="left")
    for index, column in enumerate(columns):
        printed.add_column(Text(column), justify="left" if index == 0 else "right")
    for row in rows:
        printed.add_row(*(Text(cell) for cell in row))
    Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 120).print(printed)
