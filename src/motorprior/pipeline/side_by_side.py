"""Stages that do not need each other, on a few threads: compiled code holds no interpreter lock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Event
from typing import TypeVar

from motorprior.pipeline.progress import Progress, Task

Made = TypeVar("Made")


def side_by_side(works: Sequence[Callable[[Progress], Made]], threads: int, progress: Progress) -> list[Made]:
    """Call every function with a `Progress`, at most ``threads`` at a time; returns their results in order.

    When one fails, or the user interrupts, the others end at their next `Task.advance` as if interrupted themselves,
    so that they keep what they keep then.

    Raises:
        BaseException: what the first of them that failed raised, or KeyboardInterrupt.
    """
    if threads == 1:
        return [work(progress) for work in works]
    stop = Event()
    stoppable = _Stoppable(progress, stop)
    with ThreadPoolExecutor(threads) as pool:
        try:  # an interrupt may come as soon as the first has begun
            futures = [pool.submit(work, stoppable) for work in works]
            wait(futures, return_when=FIRST_EXCEPTION)
        finally:
            stop.set()  # changes nothing where all are done
            pool.shutdown(cancel_futures=True)
    failed = [error for future in futures if (error := _failure(future)) is not None]
    for error in sorted(failed, key=lambda error: isinstance(error, KeyboardInterrupt)):
        raise error  # the cause comes before what it interrupted
    return [future.result() for future in futures]


def _failure(future: Future) -> BaseException | None:
    return None if future.cancelled() else future.exception()


class _Stoppable:
    """A `Progress` whose tasks raise KeyboardInterrupt once ``stop`` is set."""

    def __init__(self, progress: Progress, stop: Event):
        self._progress, self._stop = progress, stop

    @contextmanager
    def start(self, name: str, total: int) -> Iterator[Task]:
        """See `Progress.start`."""
        with self._progress.start(name, total) as task:
            yield _StoppableTask(task, self._stop)

    def note(self, text: str) -> None:
        """See `Progress.note`."""
        self._progress.note(text)


class _StoppableTask:
    def __init__(self, task: Task, stop: Event):
        self._task, self._stop = task, stop

    def advance(self, count: int = 1, note: str = "") -> None:
        """See `Task.advance`.

        Raises:
            KeyboardInterrupt: the work is to end here.
        """
        self._task.advance(count, note)
        if self._stop.is_set():
            raise KeyboardInterrupt
