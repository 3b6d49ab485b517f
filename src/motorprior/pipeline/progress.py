"""How far a stage is, and what a user should know meanwhile."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol, TextIO

WARNING = "warning: "
"""How a note begins that warns."""


class Task(Protocol):
    """A named unit of work that is under way."""

    def advance(self, count: int = 1, note: str = "") -> None:
        """``count`` more parts of it are done; ``note`` says how it goes."""
        ...


class Progress(Protocol):
    """Where stages report to."""

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """Begin a unit of work with ``total`` parts; it ends with the context."""
        ...

    def note(self, text: str) -> None:
        """Tell the user one thing."""
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
    """`Progress` and `Task` that show nothing; a note that warns becomes a Python warning."""

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        if text.startswith(WARNING):
            warnings.warn(text.removeprefix(WARNING), stacklevel=2)


class Lines:
    """A line of text for every note and for every unit of work that is done.

    Args:
        stream: where the lines go, for example `sys.stderr`.
    """

    def __init__(self, stream: TextIO):
        self._stream = stream

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Lines]:
        """See `Progress.start`."""
        started = time.monotonic()
        yield self
        self.note(f"{name}: {time.monotonic() - started:.1f} s")

    def advance(self, count: int = 1, note: str = "") -> None:
        """See `Task.advance`."""

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        print(text, file=self._stream, flush=True)


class WithoutNotes:
    """Shows the work of another `Progress`, and none of its notes: what is said of a baseline is not of the user's own.

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
    """Another `Progress` with its notes, and what these warned of.

    Attributes:
        warnings: so far.

    Args:
        progress: the other.
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
WARNED = Warned()
"""Of functions that are called from Python."""
