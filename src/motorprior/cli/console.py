"""Terminal output: progress, tables, errors."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from threading import Lock

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column, Table
from rich.text import Text

CONSOLE = Console(stderr=True, highlight=False)
_WIDE = 150
"""Columns of a terminal from which on there is room for a bar, too."""


class Bar:
    """Progress of one stage; on a pipe it prints a line every ten seconds instead of drawing."""

    def __init__(self, progress: Progress | None, name: str, total: int):
        self._progress, self._name, self._total, self._done = progress, name, total, 0
        self._task = progress.add_task(name, total=total, note="") if progress else None
        self._printed = time.monotonic()

    def advance(self, count: int = 1, note: str = "") -> None:
        """Count ``count`` more finished units."""
        self._done += count
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, completed=self._done, note=note)
        elif time.monotonic() - self._printed > 10.0:
            self._printed = time.monotonic()
            CONSOLE.print(f"  {self._name}: {self._done}/{self._total} {note}", markup=False, soft_wrap=True)

    def remove(self) -> None:
        """Take it from the screen."""
        if self._progress is not None and self._task is not None:
            self._progress.remove_task(self._task)


class Terminal:
    """`pipeline.progress.Progress` on the terminal; units of work in several threads have a bar each."""

    def __init__(self):
        self._lock, self._bars = Lock(), 0
        self._drawing: Progress | None = None

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Bar]:
        """Show progress of ``total`` units, and how long it took."""
        started = time.monotonic()
        if not CONSOLE.is_terminal:
            CONSOLE.print(f"{name} ...")
        shown = None
        try:
            shown = Bar(self._join(), name, total)
            yield shown
        finally:
            if shown is not None:
                shown.remove()
            self._leave()
        CONSOLE.print(f"{name}: {time.monotonic() - started:.1f} s")

    def note(self, text: str) -> None:
        """A line of its own."""
        CONSOLE.print(text, markup=False, soft_wrap=True)

    def _join(self) -> Progress | None:
        """One more bar of the drawing that all share, since rich draws one at a time; None on a pipe."""
        with self._lock:
            self._bars += 1
            if self._drawing is None and CONSOLE.is_terminal:
                self._drawing = _drawing(CONSOLE)
                self._drawing.start()
            return self._drawing

    def _leave(self) -> None:
        with self._lock:
            self._bars = max(0, self._bars - 1)
            if self._drawing is not None and self._bars == 0:
                self._drawing.stop()
                self._drawing = None


def _drawing(console: Console) -> Progress:
    """Name, parts done, bar, time and note; where there is no room for all, no bar, and the end of the note is cut."""
    count, bar = TextColumn("{task.completed:.0f}/{task.total:.0f}"), [BarColumn(20)] if console.width >= _WIDE else []
    note = TextColumn("{task.fields[note]}", table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"))
    columns = TextColumn("{task.description}"), count, *bar, TimeElapsedColumn(), note
    return Progress(*columns, console=console, transient=True, expand=True)


TERMINAL = Terminal()


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; the first column is text, the others are numbers."""
    shown = Table(title=Text(title), title_justify="left")
    for index, column in enumerate(columns):
        shown.add_column(Text(column), justify="left" if index == 0 else "right")
    for row in rows:
        shown.add_row(*(Text(cell) for cell in row))
    Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 120).print(shown)
