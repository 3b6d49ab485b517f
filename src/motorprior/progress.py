"""Progress and notes of stages."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol, TextIO

WARNING = "warning: "  # prefix of the notes that are warnings


class Task(Protocol):
    """A unit of work."""

    def advance(self, count: int = 1, note: str = "") -> None:
        """Add ``count`` finished parts; ``note`` is printed next to the progress."""
        ...


class Progress(Protocol):
    """Receives progress and notes of stages."""

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """Start a unit of work with ``total`` parts; it ends with the context."""
        ...

    def note(self, text: str) -> None:
        """Report a line to the user."""
        ...


class Silent:
    """`Progress` and `Task` without output."""

    def start(self, name: str, total: int) -> AbstractContextManager[Silent]:
        """See `Progress.start`."""
        return nullcontext(self)

    def advance(self, count: int = 1, note: str = "") -> None:
        """See `Task.advance`."""

    def note(self, text: str) -> None:
        """See `Progress.note`."""


class PythonWarnings(Silent):
    """Turns warnings into Python warnings; no other output."""

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        if text.startswith(WARNING):
            warnings.warn(text.removeprefix(WARNING), stacklevel=2)


class Lines(Silent):
    """Prints a line for every note and every finished unit of work.

    Args:
        stream: for example `sys.stderr`.
    """

    def __init__(self, stream: TextIO):
        self._stream = stream

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Lines]:
        """See `Progress.start`."""
        started = time.monotonic()
        yield self
        self.note(f"{name}: {time.monotonic() - started:.1f} s")

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        print(text, file=self._stream, flush=True)


class WithoutNotes:
    """Another `Progress` without its notes, for baselines."""

    def __init__(self, progress: Progress):
        self._progress = progress

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """See `Progress.start`."""
        return self._progress.start(name, total)

    def note(self, text: str) -> None:
        """See `Progress.note`."""


class WarningCollector(WithoutNotes):
    """Another `Progress` that also collects its ``warnings``."""

    def __init__(self, progress: Progress):
        super().__init__(progress)
        self.warnings: list[str] = []

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        if text.startswith(WARNING):
            self.warnings.append(text.removeprefix(WARNING))
        self._progress.note(text)


SILENT = Silent()
WARNED = PythonWarnings()  # default of the Python API
