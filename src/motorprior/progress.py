"""Progress and notes of stages, and stages in parallel."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol, TextIO, TypeVar

WARNING = "warning: "  # prefix of the notes that are warnings
Result = TypeVar("Result")


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


class Silent(Progress, Task):
    """`Progress` and `Task` without output."""

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """See `Progress.start`."""
        return nullcontext(self)


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
    def start(self, name: str, total: int) -> Iterator[Task]:
        """See `Progress.start`."""
        started = time.monotonic()
        yield self
        self.note(f"{name}: {time.monotonic() - started:.1f} s")

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        print(text, file=self._stream, flush=True)


class WithoutNotes(Progress):
    """Another `Progress` without its notes, for baselines."""

    def __init__(self, progress: Progress):
        self._progress = progress

    def start(self, name: str, total: int) -> AbstractContextManager[Task]:
        """See `Progress.start`."""
        return self._progress.start(name, total)


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


def usable_threads(workers: int, progress: Progress) -> int:
    """The smaller of ``workers`` and the number of cores."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers > cores:
        progress.note(f"note: {workers} workers requested, this machine has {cores} cores: using {cores}")
    return min(workers, cores)


def in_parallel(works: Sequence[Callable[[Progress], Result]], threads: int, progress: Progress) -> list[Result]:
    """Results of functions of a `Progress`, in order, ``threads`` at a time.

    Raises:
        BaseException: the first that a function raises. Functions that already run continue, no other starts.
    """
    if threads == 1:
        return [work(progress) for work in works]
    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(work, progress) for work in works]
        for future in wait(futures, return_when=FIRST_EXCEPTION).done:
            future.result()
        return [future.result() for future in futures]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
