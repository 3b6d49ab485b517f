"""Episodes in processes of this machine, for an engine that holds the interpreter lock (PyBullet)."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Any, TypeVar

from motorprior.exceptions import SimulationFault

Result = TypeVar("Result")
_simulator: Any = None  # in a worker process


class ProcessExecutor:
    """``workers`` processes, each with its own simulator.

    A process imports the program's main module, so a script needs the guard ``if __name__ == "__main__":``.

    Args:
        make_simulator: called once in every process; must be picklable, like the mapped functions and tasks.
        workers: number of processes.
    """

    def __init__(self, make_simulator: Callable[[], Any], workers: int):
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(workers, context, initializer=_begin, initargs=(make_simulator,))

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``.

        Raises:
            SimulationFault: a process ended.
            Exception: what the function raised.
        """
        try:
            return list(self._pool.map(partial(_run, function, shared), tasks))
        except BrokenProcessPool as error:
            raise SimulationFault(
                "a process ended in an episode", remedy="start again; what is finished is kept"
            ) from error

    def close(self) -> None:
        """Wait for running episodes, end the processes."""
        self._pool.shutdown(cancel_futures=True)


def _begin(make_simulator: Callable[[], Any]) -> None:
    global _simulator
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program, which ends its workers
    threading.Thread(target=_end_with_program, daemon=True).start()
    os.dup2(2, 1)  # an engine's messages are not results of the program
    _simulator = make_simulator()


def _end_with_program() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


def _run(function: Callable[[Any, Any, Any], Result], shared: Any, task: Any) -> Result:
    return function(_simulator, shared, task)
