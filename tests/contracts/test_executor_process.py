"""Processes promise what every executor does: results in order, the same bytes, faults in the caller's hands."""

import os
from collections.abc import Iterator

import numpy as np
import pytest
from far_tasks import Counter, count, die, fail, make_walker

from motorprior.exceptions import SimulationFault
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.executor import Executor, make_executor
from motorprior.locomotion.executor_process import ProcessExecutor
from motorprior.locomotion.policy_search import BestPolicy, new_search, train
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.pupper_v2.robot import PUPPER_V2


@pytest.fixture
def two() -> Iterator[ProcessExecutor]:
    executor = ProcessExecutor(Counter, 2)
    yield executor
    executor.close()


def searched(executor: Executor) -> bytes:
    shape = PolicyShape.of(PUPPER_V2, "trot", hidden_units=0, symmetric=True)
    search = new_search(ArsConfig(num_directions=2, num_top_directions=2, seed=5), shape)
    best = train(search, shape, executor, 1, BestPolicy.none_yet(shape))
    executor.close()
    return b"".join(np.asarray(each).tobytes() for each in (*search.state().values(), *best.state().values()))


def test_a_search_ends_at_the_same_bytes():
    assert searched(ProcessExecutor(make_walker, 2)) == searched(make_executor(make_walker, 1))


def test_every_process_keeps_its_simulator_and_results_are_in_order(two: ProcessExecutor):
    found = two.map(count, "shared", range(6))
    assert [each[:2] for each in found] == [("shared", task) for task in range(6)]
    by_process = {pid: [each[2] for each in found if each[3] == pid] for *_, pid in found}
    assert os.getpid() not in by_process and len(by_process) <= 2
    assert all(counts == list(range(1, len(counts) + 1)) for counts in by_process.values())


def test_a_fault_reaches_the_caller_and_the_process_goes_on(two: ProcessExecutor):
    with pytest.raises(SimulationFault) as caught:
        two.map(fail, None, [0])
    assert type(caught.value) is SimulationFault and caught.value.where == "here"
    assert str(caught.value) == f"here: broken down {'x' * 300} -> mend it {'y' * 200}"
    assert two.map(count, "x", [1])[0][:2] == ("x", 1)


def test_a_process_that_ends_is_a_fault():
    executor = ProcessExecutor(Counter, 1)
    with pytest.raises(SimulationFault, match="a process ended"):
        executor.map(die, None, [7])
    executor.close()
