"""Execution of episodes: on threads of this process, or on Ray's processes, here or on a cluster.

A round of episodes is a list of tasks with one shared object. Both are small: noise and motors are sent as seeds.
Results are in the order of the tasks and have the same bytes on every executor, given the same processor features and
libraries. The compiled episode releases the interpreter lock, so threads use several cores; PyBullet needs processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from queue import SimpleQueue
from typing import Any, Literal, Protocol, TypeVar, get_args

from motorprior.exceptions import ConfigError
from motorprior.locomotion.executor_ray import RayExecutor, ray_cluster, require_ray

Result = TypeVar("Result")
Kind = Literal["threads", "ray"]


class Executor(Protocol):
    """Maps a function of (simulator, shared, task) over tasks."""

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``; the function may depend on its arguments only."""
        ...

    def close(self) -> None:
        """Stop the workers."""
        ...


class ThreadExecutor:
    """``workers`` threads, each taking a simulator from a pool."""

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


def shared_cluster(kind: Kind, workers: int, address: str | None = None) -> AbstractContextManager[Any]:
    """Within this context, all executors of kind "ray" use one cluster; see `ray_cluster`."""
    return ray_cluster(workers, address) if kind == "ray" else nullcontext()


def require_executor(kind: Kind, address: str | None = None) -> None:
    """Check an executor before any work.

    Raises:
        ConfigError: unknown kind, Ray is not available, or an address for another executor than Ray.
    """
    if kind not in get_args(Kind):
        raise ConfigError(f"executor {kind!r} is unknown", remedy=f"use one of {get_args(Kind)}", argument="executor")
    if kind == "ray":
        require_ray(address)
    elif address is not None:
        raise ConfigError("ray_address is for the executor ray", remedy="give both", argument="ray_address")


def make_executor(
    make_simulator: Callable[[], Any], workers: int, kind: Kind = "threads", address: str | None = None
) -> Executor:
    """Make an executor.

    Args:
        make_simulator: called once per worker; for Ray it must be picklable.
        workers: number of episodes at the same time.
        kind: threads of this process, or Ray's processes.
        address: of the Ray cluster to join; without one Ray starts on this machine only.

    Raises:
        ConfigError: Ray is not available.
    """
    return RayExecutor(make_simulator, workers, address) if kind == "ray" else ThreadExecutor(make_simulator, workers)
