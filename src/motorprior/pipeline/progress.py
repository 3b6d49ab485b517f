"""Where stages report their progress and notes to."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol, TextIO

WARNING = "warning: "  # a note that begins so is a warning


class Task(Protocol):
    """A unit of work in progress."""

    def advance(self, count: int = 1, note: str = "") -> None:
        """Count ``count`` more finished parts; ``note`` is shown beside them."""
        ...


class Progress(Protocol):
    """Receives the progress of stages."""

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """Begin a unit of work with ``total`` parts; it ends with the context."""
        ...

    def note(self, text: str) -> None:
        """Show a line to the user."""
        ...


class Silent:
    """`Progress` and `Task` that show nothing."""

    def start(self, name: str, total: int) -> AbstractContextManager[Silent]:
        """See `Progress.start`."""
        return nullcontext(self)

    def advance(self, count: int = 1, note: str = "") -> None:
        """See `Task.advance`."""

    def note(self, text: str) -> None:
        """See `Progress.note`."""


class Warned(Silent):
    """`Progress` and `Task` that turn warnings into Python warnings and show nothing else."""

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
    """Another `Progress` without its notes: those of a baseline would confuse.

    Args:
        progress: the other.
    """

    def __init__(self, progress: Progress):
        self._progress = progress

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """See `Progress.start`."""
        return self._progress.start(name, total)

    def note(self, text: str) -> None:
        """See `Progress.note`."""


class Heard(WithoutNotes):
    """Another `Progress` with its notes; collects their warnings.

    Attributes:
        warnings: so far.
    """

    def __init__(self, progress: Progress):
        super().__init__(progress)
        self.warnings: list[str] = []

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        if text.startswith(WARNING):
            self.warnings.append(text.removeprefix(WARNING))
        self._progress.note(text)


SILENT = Silent()
WARNED = Warned()  # default of functions that are called from Python
