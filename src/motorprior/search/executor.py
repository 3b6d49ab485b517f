"""Where episodes run: one after the other, on threads, or on other processes and machines.

Same bytes everywhere, on machines with the same processor features and libraries: code is compiled for the processor.

A round of episodes is a list of tasks with one shared object, the policy that they perturb. Both are small: noise and
motors are sent as seeds, from which a worker draws them. Results are in the order of the tasks, whatever the order
in which they finish. The compiled episode releases the interpreter lock, so that threads run on several cores; an
engine that holds the lock (PyBullet) needs processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal, Protocol, TypeVar, get_args

from motorprior.exceptions import ConfigError
from motorprior.search.executor_ray import RayExecutor, held_cluster, require_ray
from motorprior.search.executor_threads import SerialExecutor, ThreadExecutor

Result = TypeVar("Result")
Kind = Literal["serial", "threads", "ray"]


class Executor(Protocol):
    """Maps a function of (simulator, shared, task) over tasks."""

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``; the function may depend on its arguments only."""
        ...

    def close(self) -> None:
        """Stop the workers."""
        ...


def many_executors(kind: Kind, workers: int, address: str | None = None) -> AbstractContextManager[None]:
    """While it is open, the executors of this kind that are made share what is slow to start.

    Raises:
        ConfigError: see `make_executor`.
    """
    return held_cluster(workers, address) if kind == "ray" else nullcontext()


def require_executor(kind: Kind, address: str | None = None) -> None:
    """Refuse before any work what `make_executor` would.

    Raises:
        ConfigError: unknown kind, Ray is not available, or an address for an executor that has no use for it.
    """
    _require_kind(kind, address)
    if kind == "ray":
        require_ray(address)


def _require_kind(kind: Kind, address: str | None) -> None:
    if kind not in get_args(Kind):
        raise ConfigError(f"executor {kind!r} is unknown", remedy=f"use one of {get_args(Kind)}", argument="executor")
    if kind != "ray" and address is not None:
        raise ConfigError(
            "ray_address is for the executor ray", remedy="give both, or leave it out", argument="ray_address"
        )


def make_executor(
    make_simulator: Callable[[], Any], workers: int, kind: Kind = "threads", address: str | None = None
) -> Executor:
    """Make an executor; one thread is replaced by serial execution.

    Args:
        make_simulator: called once per worker; for Ray it must pickle.
        workers: number of episodes at the same time; "serial" has one.
        kind: one after the other, threads of this process, or Ray's processes.
        address: of the Ray cluster to join; without one Ray starts on this machine only.

    Raises:
        ConfigError: unknown kind, fewer than one worker, or Ray is not available.
    """
    _require_kind(kind, address)
    if workers < 1:
        raise ConfigError(f"workers {workers} must be >= 1", remedy="use at least one worker")
    if kind == "ray":
        return RayExecutor(make_simulator, workers, address)
    if kind == "serial" or workers == 1:
        return SerialExecutor(make_simulator)
    return ThreadExecutor(make_simulator, workers)
