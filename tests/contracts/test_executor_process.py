"""Processes promise what every executor does: results in order, the same bytes, faults in the caller's hands."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from far_tasks import Counter, count, die, fail, fail_oddly, make_walker

from motorprior.exceptions import SimulationFault
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.search.ars import ArsConfig
from motorprior.search.executor import Executor, make_executor
from motorprior.search.executor_process import ProcessExecutor
from motorprior.search.policy_search import Champion, new_search, train
from motorprior.search.policy_shape import PolicyShape


@pytest.fixture
def two() -> Iterator[ProcessExecutor]:
    executor = ProcessExecutor(Counter, 2)
    yield executor
    executor.close()


def searched(executor: Executor) -> bytes:
    shape = PolicyShape.of(PUPPER_V2, "trot", units=0, symmetric=True)
    search = new_search(ArsConfig(num_directions=2, num_top_directions=2, seed=5), shape)
    champion = train(search, shape, executor, 1, Champion.none_yet(shape))
    executor.close()
    return b"".join(np.asarray(each).tobytes() for each in (*search.state().values(), *champion.state().values()))


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


@pytest.mark.parametrize(
    ("what", "kind", "words"),
    [("error", SimulationFault, "OddError: odd"), ("result", Exception, "lambda"), ("file", EOFError, "a file ended")],
)
def test_what_cannot_be_sent_is_told_and_the_process_goes_on(two: ProcessExecutor, what: str, kind: type, words: str):
    with pytest.raises(kind, match=words) as caught:
        two.map(fail_oddly, what, [0])
    assert what == "error" or "fail_oddly" in "".join(caught.value.__notes__) or "serve" in caught.value.__notes__[0]
    assert [each[:2] for each in two.map(count, "x", range(4))] == [("x", task) for task in range(4)]


def test_a_file_in_the_working_folder_is_no_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "queue.py").write_text("raise SystemExit(1)", "utf-8")
    monkeypatch.chdir(tmp_path)
    executor = ProcessExecutor(Counter, 1)
    assert executor.map(count, "x", [0])[0][:3] == ("x", 0, 1)
    executor.close()


def test_a_process_that_ends_is_named_with_its_task():
    executor = ProcessExecutor(Counter, 1)
    with pytest.raises(SimulationFault, match="task 7 ended with 3: the engine is gone"):
        executor.map(die, None, [7])
    executor.close()


def test_a_script_without_a_guard_is_not_run_again(tmp_path: Path):
    """As the main module it would start processes without end."""
    script = tmp_path / "script.py"
    script.write_text(
        "from far_tasks import Counter, count\n"
        "from motorprior.search.executor_process import ProcessExecutor\n"
        "print('once')\n"
        "executor = ProcessExecutor(Counter, 1)\n"
        "print(executor.map(count, 'x', [0])[0][:3])\n"
        "executor.close()\n",
        "utf-8",
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, env=environment, timeout=300, check=True
    )
    assert done.stdout.splitlines() == ["once", "('x', 0, 1)"]
