"""Progress and notes of stages, and stages in parallel."""

import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TextIO, TypeVar

WARNING = "warning: "  # prefix of the notes that are warnings
T = TypeVar("T")
ReportProgress = Callable[[int, str], None]  # (finished parts since the last call, text)


class Task:
    """A unit of work that reports its finished parts every ten seconds."""

    def __init__(self, line: Callable[[str], None], name: str, total: int):
        self._line = line
        self._name = name
        self._total = total
        self._done = 0
        self._printed = time.monotonic()

    def advance(self, count: int = 1, note: str = "") -> None:
        """Add ``count`` finished parts; ``note`` is printed next to the progress."""
        self._done += count
        if time.monotonic() - self._printed > 10.0:
            self._printed = time.monotonic()
            self._line(f"  {self._name}: {self._done}/{self._total} {note}".rstrip())


class Progress:
    """Gives notes of stages to ``note``, and start, progress and end of each unit of work to ``line``."""

    def __init__(
        self, note: Callable[[str], None], line: Callable[[str], None] = lambda text: None
    ):
        self.note = note
        self.line = line

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Task]:
        """Start a unit of work with ``total`` parts; it ends with the context."""
        started = time.monotonic()
        self.line(f"{name} ...")
        yield Task(self.line, name, total)
        self.line(f"{name}: {time.monotonic() - started:.1f} s")


class Lines(Progress):
    """Prints notes, and start, progress (every 10 s) and end of each task, to a stream (default: `sys.stderr`)."""

    def __init__(self, stream: TextIO | None = None):
        super().__init__(self._print, self._print)
        self._stream = stream

    def _print(self, text: str) -> None:
        stream = self._stream or sys.stderr
        stream.write(f"{text}\n")  # at once, since threads share the stream
        stream.flush()


def _warn(text: str) -> None:
    if text.startswith(WARNING):
        warnings.warn(text.removeprefix(WARNING), stacklevel=2)  # of the caller of note


SILENT = Progress(lambda text: None)
WARNED = Progress(_warn)  # warnings become Python warnings; default of the Python API
# and units of work are lines on stderr; default of what takes minutes
SHOWN = Progress(_warn, Lines().line)


def usable_threads(workers: int, progress: Progress) -> int:
    """The smaller of ``workers`` and the number of cores."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    if workers > cores:
        progress.note(
            f"note: {workers} workers requested, this machine has {cores} cores: using {cores}"
        )
    return min(workers, cores)


def in_parallel(
    works: Sequence[Callable[[Progress], T]], threads: int, progress: Progress
) -> list[T]:
    """Results of functions of a `Progress`, in order, ``threads`` at a time.

    Raises the first error of a function. Functions that already run continue, no other starts.
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
