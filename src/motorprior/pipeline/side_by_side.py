"""Stages that do not need each other, on a few threads: compiled code holds no interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Event, Lock, Thread
from typing import TypeVar

from motorprior.pipeline.progress import Progress, Task

Made = TypeVar("Made")


def threads_here(workers: int, progress: Progress) -> int:
    """``workers``, or the number of cores that this process may use, which is said, if that is less."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if workers > cores:
        progress.note(f"note: {workers} workers are more than the {cores} cores of this machine: {cores} are used")
    return min(workers, cores)


def side_by_side(works: Sequence[Callable[[Progress], Made]], threads: int, progress: Progress) -> list[Made]:
    """Call every function with a `Progress`, at most ``threads`` at a time; returns their results in order.

    When one fails, or the user interrupts, KeyboardInterrupt is raised in the others at their next `Task.advance`, and
    what waits is not begun.

    Raises:
        BaseException: what the first of them that failed raised, or KeyboardInterrupt.
    """
    if threads == 1:
        return [work(progress) for work in works]
    stop, lock, waiting = Event(), Lock(), iter(enumerate(works))
    stoppable = _Stoppable(progress, stop)
    made: dict[int, Made] = {}
    failed: list[BaseException] = []

    def run(ended: Event) -> None:
        while not stop.is_set():
            with lock:
                number, work = next(waiting, (None, None))
            if number is None or work is None:
                break
            try:
                made[number] = work(stoppable)
            except BaseException as error:
                failed.append(error)
                stop.set()
        ended.set()

    _work_together(run, min(threads, len(works)), stop, progress)
    if failed:  # the cause, not what it interrupted
        raise min(failed, key=lambda error: isinstance(error, KeyboardInterrupt))
    return [made[number] for number in range(len(works))]


def _work_together(run: Callable[[Event], None], threads: int, stop: Event, progress: Progress) -> None:
    """Call ``run`` in every thread and wait until each has set its event; an interrupt sets ``stop`` first.

    Not a ThreadPoolExecutor: interrupted while it starts a thread, it does not wait for that one. And no waiting in
    Thread.join: interrupted there, Python takes a thread that runs for one that has ended (CPython issue 90882).
    """
    events = [Event() for _ in range(threads)]
    team = [Thread(target=run, args=(event,)) for event in events]
    try:
        for thread in team:
            thread.start()
        for event in events:
            event.wait()
    except KeyboardInterrupt:
        progress.note("stopping: what is finished is kept")
        raise
    finally:
        stop.set()
        for thread, event in zip(team, events, strict=True):
            if thread.ident is not None:  # it was started
                event.wait()


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
