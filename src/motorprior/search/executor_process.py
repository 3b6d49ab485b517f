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
import tempfile
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from typing import IO, Any, TypeVar

from motorprior.exceptions import MotorPriorError, SimulationFault
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
        line = [sys.executable, "-P", "-m", "motorprior.search.executor_process"]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(folder or os.getcwd() for folder in sys.path)}
        self._written = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process
        self._process = subprocess.Popen(
            line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._written, env=environment,
            start_new_session=True,  # Ctrl-C is for the program, which closes this one
        )  # fmt: skip
        self._make: Callable[[], Any] | None = make_simulator

    def run(self, work: tuple[Callable[[Any, Any, Any], Result], Any], task: Any) -> Result:
        """Result of a function of (simulator, shared, task); ``work`` is (function, shared)."""
        question, answer = self._process.stdin, self._process.stdout
        assert question is not None and answer is not None
        try:
            if self._make is not None:
                _write(question, pickle.dumps(self._make))
                self._make = None
            _write(question, pickle.dumps((*work, task)))
            found = _read(answer)
        except (BrokenPipeError, EOFError) as error:
            raise SimulationFault(
                f"the process of task {task} ended with {self._process.wait()}{self._last_words()}",
                remedy="start again; what is finished is kept",
            ) from error
        succeeded, result = pickle.loads(found)
        if not succeeded:
            raise result
        return result

    def _last_words(self) -> str:
        self._written.seek(0)
        lines = self._written.read().decode(errors="replace").split("\n")
        said = next((line for line in reversed(lines) if line.strip()), "")
        return f": {said}" if said else ""

    def close(self) -> None:
        """End the process."""
        try:
            self._process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
        self._written.close()


def _write(file: IO[bytes], data: bytes) -> None:
    file.write(len(data).to_bytes(8, "little"))
    file.write(data)
    file.flush()


def _read(file: IO[bytes]) -> bytes:
    """What was written at a time.

    Raises:
        EOFError: who writes ended before, or while writing.
    """
    size = file.read(8)
    data = file.read(int.from_bytes(size, "little")) if len(size) == 8 else b""
    if len(size) < 8 or len(data) < int.from_bytes(size, "little"):
        raise EOFError
    return data


def serve(questions: IO[bytes], answers: IO[bytes]) -> None:
    """Read a function that makes a simulator, then (function, shared, task); write (succeeded, result) of each."""
    simulator = None
    try:
        make = _read(questions)
        while True:
            question = _read(questions)
            try:
                simulator = pickle.loads(make)() if simulator is None else simulator
                function, shared, task = pickle.loads(question)
                found = pickle.dumps((True, function(simulator, shared, task)))
            except Exception as error:
                found = _dumped(error)
            _write(answers, found)
    except (EOFError, BrokenPipeError):  # the program has no more tasks, or is gone
        if simulator is not None:
            simulator.close()


def _dumped(error: Exception) -> bytes:
    """(False, error), with where it was raised; one that cannot be sent is told in words."""
    if not isinstance(error, MotorPriorError):
        error.add_note(traceback.format_exc())
    try:
        found = pickle.dumps((False, error))
        pickle.loads(found)
    except Exception:
        found = pickle.dumps((False, SimulationFault(f"{type(error).__name__}: {error}")))
    return found


if __name__ == "__main__":
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what an engine prints is no answer
    serve(sys.stdin.buffer, pipe)
