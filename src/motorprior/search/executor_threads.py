"""Episodes in this process: one after the other, or on threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, TypeVar

Result = TypeVar("Result")


class SerialExecutor:
    """One simulator, one episode after the other."""

    def __init__(self, make_simulator: Callable[[], Any]):
        self._simulator = make_simulator()

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``."""
        return [function(self._simulator, shared, task) for task in tasks]

    def close(self) -> None:
        """Close the simulator."""
        self._simulator.close()


class ThreadExecutor:
    """``workers`` threads, each taking a simulator of its own from a pool."""

    def __init__(self, make_simulator: Callable[[], Any], workers: int):
        self._simulators = [make_simulator() for _ in range(workers)]
        self._idle: SimpleQueue[Any] = SimpleQueue()
        for simulator in self._simulators:
            self._idle.put(simulator)
        self._pool = ThreadPoolExecutor(workers)

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``."""

        def run(task: Any) -> Result:
            simulator = self._idle.get()
            try:
                return function(simulator, shared, task)
            finally:
                self._idle.put(simulator)

        return list(self._pool.map(run, tasks))

    def close(self) -> None:
        """Wait for running episodes, stop the threads, close the simulators."""
        self._pool.shutdown(cancel_futures=True)
        for simulator in self._simulators:
            simulator.close()
