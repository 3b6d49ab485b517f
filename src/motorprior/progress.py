"""Progress and notes of stages, and stages in parallel."""

from __future__ import annotations

import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol, TextIO, TypeVar

WARNING = "warning: "  # prefix of the notes that are warnings
T = TypeVar("T")
ReportProgress = Callable[[int, str], None]  # (finished parts since the last call, text)


class Task(Protocol):
    """A unit of work."""

    def advance(self, count: int = 1, note: str = "") -> None:
        """Add ``count`` finished parts; ``note`` is printed next to the progress."""


class Progress(Protocol):
    """Receives progress and notes of stages."""

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """Start a unit of work with ``total`` parts; it ends with the context."""
        ...

    def note(self, text: str) -> None:
        """Report a line to the user."""


class NoteProgress(Progress, Task):
    """Gives notes to a function, and progress to another `Progress`, if there is one."""

    def __init__(self, note: Callable[[str], None], progress: Progress | None = None):
        self._note, self._progress = note, progress

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """See `Progress.start`."""
        return self._progress.start(name, total) if self._progress else nullcontext(self)

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        self._note(text)


class Lines:
    """Prints notes, and start, progress (every 10 s) and end of each task, to a stream (default: `sys.stderr`)."""

    def __init__(self, stream: TextIO | None = None):
        self._stream = stream

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Task]:
        """See `Progress.start`."""
        started = time.monotonic()
        self.note(f"{name} ...")
        yield TextTask(self.note, name, total)
        self.note(f"{name}: {time.monotonic() - started:.1f} s")

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        stream = self._stream or sys.stderr
        stream.write(f"{text}\n")  # at once, since threads share the stream
        stream.flush()


class TextTask(Task):
    """A unit of work that reports its finished parts every ten seconds."""

    def __init__(self, note: Callable[[str], None], name: str, total: int):
        self._note, self._name, self._total, self._done, self._printed = note, name, total, 0, time.monotonic()

    def advance(self, count: int = 1, note: str = "") -> None:
        """See `Task.advance`."""
        self._done += count
        if time.monotonic() - self._printed > 10.0:
            self._printed = time.monotonic()
            self._note(f"  {self._name}: {self._done}/{self._total} {note}".rstrip())


def _warn(text: str) -> None:
    if text.startswith(WARNING):
        warnings.warn(text.removeprefix(WARNING), stacklevel=3)  # of the caller of note


SILENT = NoteProgress(lambda text: None)
WARNED = NoteProgress(_warn)  # warnings become Python warnings; default of the Python API
SHOWN = NoteProgress(_warn, Lines())  # and units of work are lines on stderr; default of what takes minutes


def usable_threads(workers: int, progress: Progress) -> int:
    """The smaller of ``workers`` and the number of cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers > cores:
        progress.note(f"note: {workers} workers requested, this machine has {cores} cores: using {cores}")
    return min(workers, cores)


def in_parallel(works: Sequence[Callable[[Progress], T]], threads: int, progress: Progress) -> list[T]:
    """Results of functions of a `Progress`, in order, ``threads`` at a time.

    Raises:
        BaseException: the first that a function raises. Functions that already run continue, no other starts.
    """
    if threads == 1:
        return [work(progress) for work in works]
    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(work, progress) for work in works]
        left = set(futures)
        while left:  # with a timeout, since Ctrl-C is lost if it comes while Python begins to wait
            done, left = wait(left, timeout=0.5, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
        return [future.result() for future in futures]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
