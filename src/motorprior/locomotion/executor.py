"""Execution of episodes: on threads of this process, or on Ray's processes, here or on a cluster.

A round of episodes is a list of tasks with one shared object. Both are small: noise and motors are
sent as seeds. Results are in the order of the tasks and have the same bytes on every executor,
given the same processor features and libraries. The compiled episode releases the interpreter lock,
so threads use several cores; PyBullet needs processes.

Ray runs the tasks of a lost worker or node again elsewhere. Without an address Ray starts a cluster
of this machine alone, regardless of RAY_ADDRESS and other clusters, and listens on the loopback
interface only: anyone with access to a port of Ray can run code.
"""

# pyright: reportMissingImports=false
# Ray is an extra.
import ipaddress
import itertools
import os
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue
from typing import Any, Literal, TypeVar

from motorprior.exceptions import ConfigError, SimulationFault

T = TypeVar("T")
ExecutorName = Literal["threads", "ray"]
RETRIES = 3  # runs of a chunk of tasks after its worker or node was lost
CHUNKS_PER_WORKER = 4  # balances episodes of different lengths
# with more, a chunk's start costs the driver more than the balance saves (docs/scaling.md)
MANY_CHUNKS = 256
_RAY_VARIABLES = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # or Ray replaces `print` for the whole process
    "RAY_TQDM_PATCH_PRINT": "0",
}
_REMEDY = "read Ray's logs; finished iterations are kept"
# simulators of a worker process, for the latest two executors (training, evaluation)
_SIMULATORS: dict[str, Any] = {}
_NUMBERS = itertools.count()


def make_executor(
    make_simulator: Callable[[], Any],
    workers: int,
    name: ExecutorName = "threads",
    address: str | None = None,
) -> "Executor":
    """An executor of ``workers`` episodes at the same time; errors as `ray_cluster`.

    ``make_simulator`` is called once per worker; for Ray it must be picklable. On a cluster
    ``workers`` only sets the size of the chunks of episodes: Ray runs a chunk on every free core.
    Without ``address`` Ray starts on this machine.
    """
    if name == "ray":
        return RayExecutor(make_simulator, workers, address)
    return ThreadExecutor(make_simulator, workers)


def require_executor(name: ExecutorName, address: str | None) -> None:
    """Raise ConfigError for an executor that cannot be used.

    Ray is not installed, no cluster answers, or an address is given without Ray.
    """
    if name != "ray":
        if address is not None:
            problem = "ray_address is for the executor ray"
            raise ConfigError(problem, remedy="give both", argument="ray_address")
        return

    has_joined_cluster = _import_ray().is_initialized()
    if address is not None and not has_joined_cluster:
        _require_answer(address)


class ThreadExecutor:
    """Threads, each taking a simulator from a pool."""

    def __init__(self, make_simulator: Callable[[], Any], workers: int):
        self._simulators = [make_simulator() for _ in range(workers)]
        self._idle: SimpleQueue[Any] = SimpleQueue()
        for simulator in self._simulators:
            self._idle.put(simulator)
        self._pool = ThreadPoolExecutor(workers)

    def map(
        self, function: Callable[[Any, Any, Any], T], shared: Any, tasks: Sequence[Any]
    ) -> list[T]:
        """Results in the order of ``tasks``; the function may depend on its arguments only."""

        def run(task: Any) -> T:
            simulator = self._idle.get()
            try:
                return function(simulator, shared, task)
            finally:
                self._idle.put(simulator)

        return list(self._pool.map(run, tasks))

    def close(self) -> None:
        """Wait for running tasks, stop the workers."""
        self._pool.shutdown(cancel_futures=True)
        for simulator in self._simulators:
            simulator.close()


class RayExecutor:
    """Processes on this machine, or those of a cluster."""

    def __init__(self, make_simulator: Callable[[], Any], workers: int, address: str | None = None):
        self._cluster = ExitStack()
        self._ray = self._cluster.enter_context(ray_cluster(workers, address))
        self._workers = workers
        self._name = f"{os.getpid()}-{next(_NUMBERS)}"
        self._make = self._ray.put(make_simulator)
        options = {"max_retries": RETRIES, "num_cpus": 1, "scheduling_strategy": "SPREAD"}
        self._run = self._ray.remote(_run_chunk).options(**options)

    def map(
        self, function: Callable[[Any, Any, Any], T], shared: Any, tasks: Sequence[Any]
    ) -> list[T]:
        """See `ThreadExecutor.map`.

        Raises:
            SimulationFault: tasks whose worker died RETRIES + 1 times, or another failure of Ray.
            Exception: what the function raised in a worker. Other chunks run on until `close`:
                cancelling one that is ending can make Ray abort this process
                (github.com/ray-project/ray/pull/54798; 2.60 still does).
        """
        num_chunks = min(CHUNKS_PER_WORKER * self._workers, max(self._workers, MANY_CHUNKS))
        size = max(1, -(-len(tasks) // num_chunks))
        chunks = [list(tasks[first : first + size]) for first in range(0, len(tasks), size)]

        common = self._ray.put((function, shared))
        futures = [self._run.remote(self._name, self._make, common, chunk) for chunk in chunks]
        results: list[Any] = []
        for chunk, future in zip(chunks, futures, strict=True):
            results += self._collect(chunk, future)
        return results

    def _collect(self, chunk: list[Any], future: Any) -> list[Any]:
        errors = self._ray.exceptions
        try:
            return self._ray.get(future)
        except (errors.WorkerCrashedError, errors.NodeDiedError) as error:
            problem = f"the worker of {chunk} died {RETRIES + 1} times ({type(error).__name__})"
            raise SimulationFault(problem, remedy=_REMEDY) from error
        except errors.RayError as error:
            cause = error.cause if isinstance(error, errors.RayTaskError) else error
            if not isinstance(cause, errors.RayError):
                raise cause from None  # Ray's own error would print the worker's traceback
            message = str(cause).strip().partition("\n")[0]
            problem = f"Ray failed ({type(cause).__name__}): {message}"
            raise SimulationFault(problem, remedy=_REMEDY) from error

    def close(self) -> None:
        """Stop the cluster, or leave it, if this executor joined it."""
        self._cluster.close()


Executor = ThreadExecutor | RayExecutor  # maps a function of (simulator, shared, task) over tasks


@contextmanager
def ray_cluster(workers: int, address: str | None = None) -> Iterator[Any]:
    """The module ray, in a cluster.

    The cluster is the one that this process has joined already, otherwise one that ends with the
    context.
    """
    ray = _import_ray()
    if ray.is_initialized():
        yield ray
        return

    quiet = {"log_to_driver": False, "logging_level": "ERROR"}
    with _default_variables(_RAY_VARIABLES):
        if address is not None:
            _require_answer(address)
            ray.init(address=address, **quiet)
        else:
            _init_on_loopback(ray, workers, **quiet)
        try:
            yield ray
        finally:
            ray.shutdown()


@contextmanager
def _default_variables(variables: Mapping[str, str]) -> Iterator[None]:
    """Environment variables that the user has not set, within this context."""
    added = variables.keys() - os.environ.keys()
    os.environ.update({name: variables[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


def _run_chunk(
    name: str, make_simulator: Callable[[], Any], common: tuple[Any, Any], tasks: list[Any]
) -> list[Any]:
    if name not in _SIMULATORS:
        # the simulators of the executor that was made first
        while len(_SIMULATORS) >= 2:
            _SIMULATORS.pop(next(iter(_SIMULATORS))).close()
        _SIMULATORS[name] = make_simulator()

    function, shared = common
    return [function(_SIMULATORS[name], shared, task) for task in tasks]


def _init_on_loopback(ray: Any, workers: int, **options: Any) -> None:
    """Start a cluster of this machine, whose processes listen on the loopback interface.

    Ray's switch for it is an environment variable, named after the systems where loopback is the
    default. Its processes read it when they start, and this one when it imported Ray
    (_private/services.py, Ray 2.9 to 2.60).
    """
    constants = ray._private.ray_constants
    variable = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
    imported_value = constants.ENABLE_RAY_CLUSTER
    user_value = os.environ.get(variable)
    constants.ENABLE_RAY_CLUSTER = False
    os.environ[variable] = "0"
    try:
        ray.init(address="local", num_cpus=workers, include_dashboard=False, **options)
    finally:
        constants.ENABLE_RAY_CLUSTER = imported_value
        del os.environ[variable]
        if user_value is not None:
            os.environ[variable] = user_value

    host = ray.util.get_node_ip_address()
    if not ipaddress.ip_address(host).is_loopback:
        ray.shutdown()
        problem = f"Ray {ray.__version__} listens on {host}, where other machines reach it"
        raise ConfigError(problem, remedy="use the executor threads, or another version of Ray")


def _require_answer(address: str) -> None:
    """Reject an address that accepts no connection; Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=10.0).close()
    except (OSError, ValueError, OverflowError) as error:
        problem = f"no Ray cluster answers at ray_address ({error})"
        remedy = "give HOST:PORT of its head"
        raise ConfigError(problem, where=address, remedy=remedy, argument="ray_address") from error


def _import_ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise ConfigError("Ray is not installed", remedy="pip install ray") from error
    return ray
