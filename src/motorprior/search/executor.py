"""Where episodes run: here, or on threads. Same bytes either way.

A task is (candidate, seed); results come back in the order of the tasks, whatever order they end in.
The compiled episode releases the interpreter lock, so threads run on as many cores.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

Result = TypeVar("Result")


class Executor(Protocol):
    """Maps a function of (simulator, task) over tasks."""

    def map(self, function: Callable[[Any, Any], Result], tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``."""
        ...

    def close(self) -> None:
        """Stop the workers."""
        ...


class SerialExecutor:
    """One simulator, one episode after the other."""

    def __init__(self, make_simulator: Callable[[], Any]):
        self._simulator = make_simulator()

    def map(self, function: Callable[[Any, Any], Result], tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``."""
        return [function(self._simulator, task) for task in tasks]

    def close(self) -> None:
        """Nothing to stop."""


class ThreadExecutor:
    """``workers`` threads, each taking a simulator of its own from a pool."""

    def __init__(self, make_simulator: Callable[[], Any], workers: int):
        self._idle: SimpleQueue[Any] = SimpleQueue()
        for _ in range(workers):
            self._idle.put(make_simulator())
        self._pool = ThreadPoolExecutor(workers)

    def map(self, function: Callable[[Any, Any], Result], tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``."""

        def run(task: Any) -> Result:
            simulator = self._idle.get()
            try:
                return function(simulator, task)
            finally:
                self._idle.put(simulator)

        return list(self._pool.map(run, tasks))

    def close(self) -> None:
        """Wait for running episodes and stop the threads."""
        self._pool.shutdown(cancel_futures=True)


def make_executor(make_simulator: Callable[[], Any], workers: int) -> Executor:
    """Serial for one worker, threads for more."""
    if workers <= 1:
        return SerialExecutor(make_simulator)
    return ThreadExecutor(make_simulator, workers)
