"""A test in real time that fails is skipped if the machine stood still in its last attempt, and fails otherwise."""

import numpy as np
import pytest
import standstill

from motorprior.hardware.machine import MachineReport

FAILING = """
import pytest

@pytest.mark.real_time
@pytest.mark.flaky(reruns=1)
def test_robot():
    assert False, "stale telemetry"

@pytest.mark.real_time
def test_walks():
    pass

def test_sum():
    assert 1 + 1 == 3
"""


def report(worst: float, *overdue: tuple[float, float]) -> MachineReport:
    return MachineReport(1000, 3e-5, 2e-4, worst, (np.array(overdue).reshape(-1, 2), np.empty((0, 2))))


@pytest.mark.parametrize(
    ("found", "is_judged"),
    [
        (None, True),
        (report(0.03, (5.0, 5.03)), True),
        (report(1.14, (5.0, 6.14)), False),
        (report(0.04, *((at, at + 0.04) for at in np.arange(5.0, 6.0, 0.1))), False),
    ],
    ids=["nobody timed it", "a short stall", "a long stall", "many short stalls"],
)
def test_a_machine_stood_still_for_long_or_for_a_share_of_the_test(found: MachineReport | None, is_judged: bool):
    assert (standstill.stood_still(found, 2.0) is None) == is_judged


@pytest.mark.parametrize(("worst", "outcomes"), [(0.01, (1, 2, 0)), (1.14, (1, 1, 1))], ids=["quiet", "stalling"])
def test_only_a_failure_in_real_time_on_a_stalling_machine_is_a_skip(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, worst: float, outcomes: tuple[int, int, int]
):
    monkeypatch.setattr(standstill.BareTimers, "stop", lambda _: report(worst))
    pytester.makeini("[pytest]\nmarkers =\n    real_time: x")
    pytester.makepyfile(FAILING)
    done = pytester.runpytest_inprocess("-p", "standstill", "-rs", "--import-mode=importlib")
    passed, failed, skipped = outcomes
    found = done.parseoutcomes()
    assert (found["passed"], found["failed"], found.get("skipped", 0), found["rerun"]) == (passed, failed, skipped, 1)
    assert ("this machine stood still for up to 1140 ms" in done.stdout.str()) == bool(skipped)
