"""Contract of all executors: results in order, equal bytes on any workers, no result is lost."""

# pyright: reportMissingImports=false
# Ray is an extra.
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from drawn_motors import draw_pd

from motorprior.exceptions import SimulationFault
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import Executor, make_executor
from motorprior.locomotion.policy_search import PolicySearch
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.scene import Scene, WalkConfig, WalkSimulator

SHAPE = PolicyShape.of(PUPPER_V2, hidden_units=0, symmetric=True)
WALK = WalkConfig(episode_steps=60, randomization=Randomization(joint_noise=0.01, mass=(0.9, 1.1)))


def make_walker():
    return WalkSimulator(Scene(PUPPER_V2, draw_pd, WALK))


def searched(executor: Executor, iterations: int = 2) -> bytes:
    """State of a policy search after these iterations, as bytes."""
    search = PolicySearch(ArsConfig(num_directions=4, num_top_directions=2, seed=5), SHAPE)
    search.train(executor, iterations)

    assert np.any(search.ars.parameters != 0.0)

    return b"".join(np.asarray(value).tobytes() for value in search.state().values())


@pytest.fixture(scope="module")
def serial() -> bytes:
    return searched(make_executor(make_walker, 1))


@pytest.mark.parametrize("workers", [2, 3])
def test_any_number_of_threads_gives_the_same_search(serial, workers):
    executor = make_executor(make_walker, workers)

    assert searched(executor) == serial

    executor.close()


class Sleeper:
    """A simulator that counts how often it is closed."""

    closed = 0

    def close(self):
        type(self).closed += 1


def nap(simulator, shared, task):
    time.sleep(0.02 * (5 - task))
    return shared, task


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_results_are_in_the_order_of_the_tasks(workers):
    executor = make_executor(Sleeper, workers)
    Sleeper.closed = 0

    assert executor.map(nap, "x", range(5)) == [("x", task) for task in range(5)]
    assert executor.map(nap, "y", []) == []

    executor.close()

    assert Sleeper.closed == workers


def broken(simulator, shared, task):
    raise SimulationFault("broken down", where="here", remedy="mend it")


@pytest.mark.parametrize(("workers", "name"), [(1, "threads"), (2, "threads"), (1, "ray")])
def test_a_fault_reaches_the_caller(request, workers, name):
    if name == "ray":
        request.getfixturevalue("ray")

    executor = make_executor(Sleeper, workers, name)

    try:
        with pytest.raises(SimulationFault) as caught:
            executor.map(broken, None, range(3))
        # one line
        assert type(caught.value) is SimulationFault
        assert str(caught.value) == "here: broken down -> mend it"
    finally:
        executor.close()


# Ray: starting it takes seconds, so the tests below share one cluster of two nodes.


@pytest.fixture(scope="module")
def patient_ray() -> Iterator[None]:
    """A Ray that gives its own processes time to start on a busy machine."""
    with pytest.MonkeyPatch.context() as context:
        context.setenv("RAY_agent_register_timeout_ms", "180000")
        context.setenv("RAY_gcs_server_port_wait_time_s", "120")
        yield


@pytest.fixture(scope="module")
def ray(patient_ray):
    module = pytest.importorskip("ray", reason="Ray is not installed: pip install ray")
    import sys

    import ray.cloudpickle

    for name in (__name__, draw_pd.__module__):
        ray.cloudpickle.register_pickle_by_value(sys.modules[name])

    return module


@pytest.fixture(scope="module")
def cluster(ray):
    """The head of a cluster, on one core; it notices a lost node within 1 s instead of 15 s."""
    from ray.cluster_utils import Cluster

    often = {
        "health_check_initial_delay_ms": 0,
        "health_check_period_ms": 250,
        "health_check_failure_threshold": 3,
    }
    head = {"num_cpus": 1, "include_dashboard": False, "_system_config": often}
    nodes = Cluster(initialize_head=True, head_node_args=head)
    yield nodes
    nodes.shutdown()


def remember(simulator, shared, task):
    """Leave a mark with the node of the task; the task ends only on the nodes that stay."""
    import ray as there

    folder, doomed_id = shared
    node = there.get_runtime_context().get_node_id()
    (Path(folder) / f"{task}-{os.getpid()}-{node}").touch()
    time.sleep(60.0 if node == doomed_id else 0.5)

    return task * task


def die(simulator, shared, task):
    if task == 3:
        os._exit(1)
    return task


@pytest.mark.slow
def test_a_killed_node_loses_no_result(ray, cluster, tmp_path, serial):
    doomed = cluster.add_node(num_cpus=1)
    executor = make_executor(make_walker, 2, "ray", cluster.address)

    try:
        assert searched(executor) == serial  # both nodes at work

        doomed_id = doomed.node_id
        killer = threading.Thread(
            target=kill_when_busy, args=(doomed, tmp_path, doomed_id), daemon=True
        )
        killer.start()
        squares = executor.map(remember, (str(tmp_path), doomed_id), range(10))
        assert squares == [task * task for task in range(10)]
        killer.join(60.0)
        assert not killer.is_alive(), "no task came to the node that is to die"
        marks = [mark.name.split("-") for mark in tmp_path.iterdir()]
        lost = {task for task, _, node in marks if node == doomed_id}
        elsewhere = {task for task, _, node in marks if node != doomed_id}
        assert lost
        assert elsewhere == {str(task) for task in range(10)}

        assert searched(executor) == serial  # on the remaining node
        with pytest.raises(SimulationFault, match="4"):
            executor.map(die, None, range(4))
        assert executor.map(nap, None, range(2)) == [(None, 0), (None, 1)]
    finally:
        executor.close()


def kill_when_busy(node, folder, node_id):
    while not any(mark.name.endswith(node_id) for mark in folder.iterdir()):
        time.sleep(0.02)
    node.kill_raylet(check_alive=False)
