"""``python -m motorprior.search.executor_process``: episodes in processes of this machine.

For an engine that holds the interpreter lock (PyBullet). A process is a new interpreter that imports by name what it is
sent; unlike those of `multiprocessing` it does not import the program's main module, which a script without a guard
would run again. It ends with the program that started it.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from typing import IO, Any, TypeVar

from motorprior.exceptions import SimulationFault
from motorprior.search.executor_threads import ThreadExecutor

Result = TypeVar("Result")


class ProcessExecutor:
    """``workers`` processes, each with a simulator of its own.

    Args:
        make_simulator: called once in every process; it and what is mapped are found there by their modules' names.
        workers: number of processes.
    """

    def __init__(self, make_simulator: Callable[[], Any], workers: int):
        self._threads = ThreadExecutor(partial(_Process, make_simulator), workers)

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``.

        Raises:
            SimulationFault: a process ended.
            Exception: what the function raised there.
        """
        return self._threads.map(_Process.run, (function, shared), tasks)

    def close(self) -> None:
        """Wait for running episodes, end the processes."""
        self._threads.close()


class _Process:
    """A process with a simulator."""

    def __init__(self, make_simulator: Callable[[], Any]):
        line = [sys.executable, "-m", "motorprior.search.executor_process"]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self._process = subprocess.Popen(
            line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment,
            start_new_session=True,  # Ctrl-C is for the program, which closes this one
        )  # fmt: skip
        self._make: Callable[[], Any] | None = make_simulator

    def run(self, work: tuple[Callable[[Any, Any, Any], Result], Any], task: Any) -> Result:
        """Result of a function of (simulator, shared, task); ``work`` is (function, shared)."""
        question, answer = self._process.stdin, self._process.stdout
        assert question is not None and answer is not None
        try:
            if self._make is not None:
                _send(question, self._make)
                self._make = None
            _send(question, (*work, task))
            succeeded, result = pickle.load(answer)
        except (BrokenPipeError, EOFError) as error:
            raise SimulationFault(
                f"the process of task {task} ended with {self._process.wait()}",
                remedy="read what it wrote; finished iterations are kept",
            ) from error
        if not succeeded:
            raise result
        return result

    def close(self) -> None:
        """End the process."""
        try:
            self._process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()


def _send(file: IO[bytes], value: Any) -> None:
    pickle.dump(value, file, pickle.HIGHEST_PROTOCOL)
    file.flush()


def serve(questions: IO[bytes], answers: IO[bytes]) -> None:
    """Read a function that makes a simulator, then (function, shared, task); write (succeeded, result) of each."""
    simulator = None
    try:
        make = pickle.load(questions)
        while True:
            try:
                function, shared, task = pickle.load(questions)
                simulator = make() if simulator is None else simulator
                found = (True, function(simulator, shared, task))
            except EOFError:
                raise
            except Exception as error:
                found = (False, error)
            _send(answers, found)
    except (EOFError, BrokenPipeError):  # the program has no more tasks, or is gone
        if simulator is not None:
            simulator.close()


if __name__ == "__main__":
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what an engine prints is no answer
    serve(sys.stdin.buffer, pipe)
