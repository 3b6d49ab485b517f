"""Terminal output: progress, notes and tables."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Lock

from rich.console import Console
from rich.progress import Progress, TextColumn, TimeElapsedColumn
from rich.table import Column, Table
from rich.text import Text

from motorprior.progress import Lines

CONSOLE = Console(stderr=True, highlight=False)


class Bar:
    """Progress of one unit of work."""

    def __init__(self, progress: Progress, name: str, total: int):
        self._progress, self.task = progress, progress.add_task(name, total=total, note="")

    def advance(self, count: int = 1, note: str = "") -> None:
        """Count ``count`` more finished parts."""
        self._progress.update(self.task, advance=count, note=note)


class Bars:
    """`progress.Progress` on a terminal; units of work in several threads have a bar each."""

    def __init__(self):
        count = TextColumn("{task.completed:.0f}/{task.total:.0f}")
        note = TextColumn("{task.fields[note]}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"))
        columns = TextColumn("{task.description}"), count, TimeElapsedColumn(), note
        self._progress = Progress(*columns, console=CONSOLE, transient=True, expand=True)
        self._lock = Lock()

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Bar]:
        """Show the progress of ``total`` parts, then the time."""
        started = time.monotonic()
        with self._lock:  # threads share one drawing, since rich allows only one
            self._progress.start()
            bar = Bar(self._progress, name, total)
        try:
            yield bar
        finally:
            with self._lock:
                self._progress.remove_task(bar.task)
                if not self._progress.tasks:
                    self._progress.stop()
        self.note(f"{name}: {time.monotonic() - started:.1f} s")

    def note(self, text: str) -> None:
        """Print a line of its own."""
        CONSOLE.print(text, markup=False, soft_wrap=True)


TERMINAL = Bars() if CONSOLE.is_terminal else Lines()


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
