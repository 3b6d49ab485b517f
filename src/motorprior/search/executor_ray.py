"""Episodes on many processes and machines, by Ray.

Tasks are stateless, so Ray itself runs those of a lost worker or node again elsewhere; a worker keeps a
simulator between tasks, which changes no result. Nothing is joined unasked: without an address Ray starts a
cluster of this machine alone, whatever RAY_ADDRESS says or other clusters run, and listens on the loopback interface
only: who reaches a port of Ray can run code.
"""

# pyright: reportMissingImports=false
# An extra.
from __future__ import annotations

import ipaddress
import itertools
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from motorprior.exceptions import ConfigError, SimulationFault

Result = TypeVar("Result")
RETRIES = 3
"""Times a chunk of tasks runs again after its worker or node was lost."""
CHUNKS_PER_WORKER = 4
"""Number of chunks per worker; several balance episodes of different lengths."""
MANY_CHUNKS = 256
"""Number of chunks beyond which each worker gets one chunk, since starting more costs the driver more time than the
balance saves (docs/scaling.md)."""
_REMEDY = "read Ray's logs; finished iterations are kept"
_CLUSTERS = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
_SIMULATORS: dict[str, Any] = {}
"""In a worker process: simulators of the executors it worked for last."""
_MOST_SIMULATORS = 2
"""A training and its contests take turns."""
_NUMBERS = itertools.count()
_HELD: list[str | None] = []
"""Address of the cluster that `held_cluster` keeps, while it does."""


@contextmanager
def held_cluster(workers: int, address: str | None = None) -> Iterator[None]:
    """Keep one cluster for all `RayExecutor` that are made while this is open; they must name the same address.

    Where one is held already, nothing happens.

    Raises:
        ConfigError: see `RayExecutor`.
    """
    if [address] == _HELD:
        yield
        return
    ray = _import_ray()
    _join(ray, workers, address)
    _HELD.append(address)
    try:
        yield
    finally:
        _HELD.clear()
        ray.shutdown()


class RayExecutor:
    """``workers`` processes on this machine, or those of a cluster.

    Args:
        make_simulator: what a worker calls once; pickled by value.
        workers: processes of this machine; on a cluster the number that episodes are cut into chunks for: Ray runs a
            chunk on every core that is free.
        address: of a running cluster to join.

    Raises:
        ConfigError: Ray is not installed, this process is in a cluster that was not asked for, the one that was asked
            for does not answer, or one of this machine alone would be open to others.
    """

    def __init__(self, make_simulator: Callable[[], Any], workers: int, address: str | None = None):
        self._ray, self._workers = _import_ray(), workers
        self._owns = [address] != _HELD
        if self._owns:
            _join(self._ray, workers, address)
        self._name = f"{os.getpid()}-{next(_NUMBERS)}"
        self._make = self._ray.put(make_simulator)
        options = {"max_retries": RETRIES, "num_cpus": 1, "scheduling_strategy": "SPREAD"}
        self._run = self._ray.remote(_run_chunk).options(**options)

    def map(self, function: Callable[[Any, Any, Any], Result], shared: Any, tasks: Sequence[Any]) -> list[Result]:
        """Results in the order of ``tasks``.

        Raises:
            SimulationFault: tasks whose worker died RETRIES + 1 times, or another failure of Ray.
            Exception: what the function raised in a worker. Chunks that are left run on until `close`: to cancel one
                that is ending lets Ray abort this process (github.com/ray-project/ray/pull/54798; 2.60 still does).
        """
        size = chunk_size(len(tasks), self._workers)
        chunks = [list(tasks[first : first + size]) for first in range(0, len(tasks), size)]
        common = self._ray.put((function, shared))
        running = [self._run.remote(self._name, self._make, common, chunk) for chunk in chunks]
        collected = [self._collect(chunk, reference) for chunk, reference in zip(chunks, running, strict=True)]
        return list(itertools.chain.from_iterable(collected))

    def _collect(self, chunk: list[Any], reference: Any) -> list[Any]:
        """Results of a chunk; what went wrong in the words of this process."""
        known = self._ray.exceptions
        try:
            return self._ray.get(reference)
        except (known.WorkerCrashedError, known.NodeDiedError) as error:
            raise SimulationFault(
                f"the worker of {chunk} died {RETRIES + 1} times ({type(error).__name__})", remedy=_REMEDY
            ) from error
        except known.RayError as error:
            cause = error.cause if isinstance(error, known.RayTaskError) else error
            if not isinstance(cause, known.RayError):
                raise cause from None  # Ray's own error would print the worker's traceback
            said = str(cause).strip().partition("\n")[0]
            raise SimulationFault(f"Ray failed ({type(cause).__name__}): {said}", remedy=_REMEDY) from error

    def close(self) -> None:
        """Leave the cluster, unless it is held; stops it if it was started here."""
        if self._owns:
            self._ray.shutdown()


def require_ray(address: str | None = None) -> None:
    """Refuse before any work what `RayExecutor` would.

    Raises:
        ConfigError: Ray is not installed, or no cluster answers at the address.
    """
    _import_ray()
    if address is not None and [address] != _HELD:
        _require_answer(address)


def chunk_size(tasks: int, workers: int) -> int:
    """Number of tasks in a chunk."""
    chunks = min(CHUNKS_PER_WORKER * workers, max(workers, MANY_CHUNKS))
    return max(1, -(-tasks // chunks))


def _run_chunk(name: str, make_simulator: Callable[[], Any], common: tuple[Any, Any], tasks: list[Any]) -> list[Any]:
    """In a worker: run the tasks one after the other."""
    if name not in _SIMULATORS:
        while len(_SIMULATORS) >= _MOST_SIMULATORS:
            _SIMULATORS.pop(next(iter(_SIMULATORS))).close()
        _SIMULATORS[name] = make_simulator()
    function, shared = common
    return [function(_SIMULATORS[name], shared, task) for task in tasks]


def _join(ray: Any, workers: int, address: str | None) -> None:
    if ray.is_initialized():
        raise ConfigError(
            "this process is in a Ray cluster already", remedy="call ray.shutdown() first, and give the address to join"
        )
    quiet = {"log_to_driver": False, "logging_level": "ERROR"}
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_TQDM_PATCH_PRINT", "0")  # or Ray replaces `print` for the whole process
    if address is None:
        with _on_loopback(ray):
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
        _require_loopback(ray)
        return
    _require_answer(address)
    ray.init(address=address, **quiet)


@contextmanager
def _on_loopback(ray: Any) -> Iterator[None]:
    """What Ray starts while this is open listens on the loopback interface, its default on Windows and macOS.

    Ray's switch for it is a variable of the environment, named after those systems, that its processes read when they
    start, and this one read when it imported Ray (_private/services.py, get_node_ip_address, Ray 2.9 to 2.60).
    """
    constants, before = ray._private.ray_constants, os.environ.get(_CLUSTERS)
    read, os.environ[_CLUSTERS] = constants.ENABLE_RAY_CLUSTER, "0"
    constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        constants.ENABLE_RAY_CLUSTER = read
        if before is None:
            del os.environ[_CLUSTERS]
        else:
            os.environ[_CLUSTERS] = before


def _require_loopback(ray: Any) -> None:
    """Stop a cluster that others can reach.

    Raises:
        ConfigError: this version of Ray does not heed its switch.
    """
    address = ray.util.get_node_ip_address()
    if not ipaddress.ip_address(address).is_loopback:
        ray.shutdown()
        raise ConfigError(
            f"Ray {ray.__version__} listens on {address}, where other machines reach it",
            remedy="use the executor threads, or another version of Ray",
        )


def _require_answer(address: str) -> None:
    """Refuse an address that accepts no connection; Ray itself would try for minutes.

    Raises:
        ConfigError: not HOST:PORT, or no connection.
    """
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10.0).close()
    except (OSError, ValueError, OverflowError) as error:
        raise ConfigError(
            f"no Ray cluster answers at ray_address ({error})",
            where=address,
            remedy="give HOST:PORT of its head",
            argument="ray_address",
        ) from error


def _import_ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ConfigError("Ray is not installed", remedy="pip install 'motorprior[ray]'") from error
    return ray
