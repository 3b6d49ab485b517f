"""Progress and notes of stages, and stages in parallel."""

import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, TextIO, TypeVar

T = TypeVar("T")
SECONDS_PER_LINE = 10.0  # time between two lines of a unit of work [s]
LINES_OF_SPEED = 10  # lines from which the time left is estimated
ReportProgress = Callable[[int, str], None]  # (finished parts since the last call, text)


@dataclass(frozen=True)
class Note:
    """A text for the user, and whether it is a fact or a warning."""

    severity: Literal["info", "warning"]
    text: str
    topic: str = ""  # for programs that leave out notes of a topic

    def __str__(self) -> str:
        """The text; a warning begins with "warning: "."""
        return f"warning: {self.text}" if self.severity == "warning" else self.text


class Task:
    """A unit of work that reports its finished parts, and the time left, every ten seconds."""

    def __init__(self, print_line: Callable[[str], None], name: str, total: int):
        self._print_line = print_line
        self._name = name
        self._total = total
        self._done = 0
        self._printed = time.monotonic()
        # (time [s], finished parts) of the last lines; the first line of a continued run has parts
        # that were loaded in no time
        self._lines: list[tuple[float, int]] = []

    def advance(self, count: int = 1, note: str = "") -> None:
        """Add ``count`` finished parts; ``note`` is printed next to the progress."""
        self._done += count
        now = time.monotonic()
        if now - self._printed > SECONDS_PER_LINE:
            self._printed = now
            line = f"  {self._name}: {self._done}/{self._total}{self._time_left(now)}"
            self._print_line(f"{line}; {note}" if note else line)

    def _time_left(self, now: float) -> str:
        """The time left at the speed of the last lines; empty while it is unknown."""
        self._lines = [*self._lines[-LINES_OF_SPEED:], (now, self._done)]
        first_time, first_done = self._lines[0]
        if self._done <= first_done or self._done >= self._total:
            return ""
        seconds = (self._total - self._done) * (now - first_time) / (self._done - first_done)
        return f", about {duration_text(seconds)} left"


def duration_text(seconds: float) -> str:
    """For example "40 s", "7 min", "1.5 h"."""
    if seconds < 60.0:
        return f"{10 * math.ceil(seconds / 10)} s"
    if seconds < 3600.0:
        return f"{math.ceil(seconds / 60)} min"
    return f"{seconds / 3600:.1f} h"


class Progress:
    """The destination of a stage's reports.

    ``show`` receives notes. ``print_line`` receives a line at the start and end of each unit of
    work, and lines of its progress.
    """

    def __init__(
        self, show: Callable[[Note], None], print_line: Callable[[str], None] = lambda text: None
    ):
        self._show = show
        self.print_line = print_line

    def note(self, text: str) -> None:
        """Report a fact."""
        self._show(Note("info", text))

    def warn(self, text: str) -> None:
        """Report a warning."""
        self._show(Note("warning", text))

    def report(self, note: Note) -> None:
        """Report a note of either severity."""
        self._show(note)

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Task]:
        """Start a unit of work with ``total`` parts; it ends with the context."""
        started = time.monotonic()
        self.print_line(f"{name} ...")
        yield Task(self.print_line, name, total)
        self.print_line(f"{name}: {time.monotonic() - started:.1f} s")


class Lines(Progress):
    """Prints to a stream: notes, and start, progress (every 10 s) and end of each unit of work.

    The default stream is `sys.stderr`.
    """

    def __init__(self, stream: TextIO | None = None):
        super().__init__(self._print, self._print)
        self._stream = stream

    def _print(self, line: Note | str) -> None:
        stream = self._stream or sys.stderr
        stream.write(f"{line}\n")  # at once, since threads share the stream
        stream.flush()


def _as_python_warning(note: Note) -> None:
    if note.severity == "warning":
        warnings.warn(note.text, stacklevel=3)  # at the line that calls warn or report


# reports nothing
SILENT = Progress(lambda note: None)
# warnings become Python warnings: default of the Python API
PYTHON_WARNINGS = Progress(_as_python_warning)
# also prints units of work to stderr: default of functions that take minutes
WARNINGS_AND_PROGRESS = Progress(_as_python_warning, Lines().print_line)


def usable_threads(workers: int, progress: Progress) -> int:
    """The smaller of ``workers`` and the number of cores."""
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):  # this process may use fewer
        cores = len(os.sched_getaffinity(0))
    if workers > cores:
        progress.note(f"{workers} workers requested, this machine has {cores} cores: using {cores}")
    return min(workers, cores)


def in_parallel(
    works: Sequence[Callable[[Progress], T]], threads: int, progress: Progress
) -> list[T]:
    """Call each function with ``progress``, ``threads`` at a time; returns results in their order.

    Raises the first error of a function. Functions that already run then continue, and no other
    function starts.
    """
    if threads == 1:
        return [work(progress) for work in works]

    pool = ThreadPoolExecutor(threads)
    try:
        futures = [pool.submit(work, progress) for work in works]
        unfinished = set(futures)
        while unfinished:
            # Wait with a timeout: a Ctrl-C at the moment when Python begins to wait is not handled
            # before the wait ends.
            done, unfinished = wait(unfinished, timeout=0.5, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
        return [future.result() for future in futures]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
