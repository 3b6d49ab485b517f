"""A test in real time that never passes is skipped if the machine stood still meanwhile, and fails otherwise."""

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import standstill

from motorprior.hardware.machine import MachineReport

TESTS = """
import pytest

@pytest.mark.real_time
@pytest.mark.flaky(reruns=1)
def test_robot():
    assert False, "stale telemetry"

@pytest.mark.real_time
@pytest.mark.flaky(1)
def test_robot_that_misses_a_name():
    no_such_name

@pytest.mark.real_time
def test_walks():
    pass

def test_sum():
    assert 1 + 1 == 3
"""
QUIET, STALLED = 0.01, 1.14


def report(worst: float, *overdue: tuple[float, float]) -> MachineReport:
    return MachineReport(1000, 3e-5, 2e-4, worst, (np.array(overdue).reshape(-1, 2), np.empty((0, 2))))


@pytest.mark.parametrize(
    ("found", "is_judged"),
    [
        (None, True),
        (report(0.08, (5.0, 5.08)), True),
        (report(1.14, (5.0, 6.14)), False),
        (report(0.04, *((at, at + 0.04) for at in np.arange(5.0, 6.0, 0.1))), False),
    ],
    ids=["nobody timed it", "a short stall", "a long stall", "many short stalls"],
)
def test_a_machine_stood_still_for_long_or_for_a_share_of_the_test(found: MachineReport | None, is_judged: bool):
    assert (standstill.stood_still(found, 2.0) is None) == is_judged


@pytest.fixture
def waits() -> list[int]:
    """An entry for every time that a session waited for the machine."""
    return []


@pytest.fixture
def session(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch, waits: list[int]) -> Iterator:
    """Run tests on a machine that was late by these times [s], attempt by attempt, then by the last of them."""

    def run(*worst: float, tests: str = TESTS, most: float = 1.0) -> tuple[dict[str, int], str, int]:
        late = iter(worst)
        monkeypatch.setattr(standstill, "MOST", most)
        monkeypatch.setattr(standstill, "_wait_until_well", lambda stash: waits.append(1))
        monkeypatch.setattr(
            standstill, "BareTimers", lambda: SimpleNamespace(stop=lambda: report(next(late, worst[-1])))
        )
        pytester.makeini("[pytest]\nmarkers =\n    real_time: x")
        pytester.makepyfile(tests)
        done = pytester.runpytest_inprocess("-p", "standstill", "-rs", "--import-mode=importlib")
        return done.parseoutcomes(), done.stdout.str(), int(done.ret)

    yield run


@pytest.mark.parametrize(
    ("worst", "excused"),
    [((QUIET,), 0), ((STALLED,), 1), ((QUIET, STALLED), 0), ((STALLED, QUIET), 0)],
    ids=["quiet", "stalling", "stalling in the last attempt", "quiet in the last attempt"],
)
def test_only_a_failure_in_real_time_while_the_machine_stands_still_is_a_skip(session, worst, excused: int):
    found, said, _ = session(*worst)
    assert (found["passed"], found["failed"], found.get("skipped", 0)) == (1, 3 - excused, excused)
    assert found["rerun"] == 2, "one of each that is marked so"
    assert ("stood still for up to 1140 ms" in said and "failed with AssertionError: stale tel" in said) == bool(
        excused
    )


@pytest.mark.parametrize(
    ("worst", "excused"),
    [((STALLED, STALLED, QUIET, STALLED, STALLED), True), ((STALLED, QUIET, QUIET, STALLED, STALLED), False)],
    ids=["once", "twice"],
)
def test_of_five_attempts_one_may_fail_while_the_machine_is_well(
    session, waits: list[int], worst: tuple[float, ...], excused: bool
):
    tests = TESTS.split("@pytest.mark.real_time\n@pytest.mark.flaky(1)")[0].replace("reruns=1", "reruns=4")
    found, _, code = session(*worst, tests=tests)
    assert (found["rerun"], found.get("skipped", 0), code) == (4, int(excused), int(not excused))
    assert len(waits) == worst[:-1].count(STALLED), "once after each attempt that the machine spoiled"


BREAKS_LATER = """
import pytest

@pytest.fixture
def robot():
    yield
    assert False, "it did not idle"

@pytest.mark.real_time
def test_robot(robot):
    assert False, "stale telemetry"
"""


@pytest.mark.parametrize(("worst", "excused"), [(STALLED, True), (QUIET, False)], ids=["stalling", "quiet"])
def test_a_teardown_after_a_failure_is_judged_as_the_failure(session, worst: float, excused: bool):
    found, _, code = session(worst, tests=BREAKS_LATER)
    outcomes = {"skipped": 2} if excused else {"failed": 1, "errors": 1}
    assert {name: found.get(name, 0) for name in outcomes} == outcomes and code == int(not excused)


def test_a_session_in_which_next_to_nothing_was_judged_has_failed(session):
    tests = TESTS.split("@pytest.mark.real_time\n@pytest.mark.flaky(1)")[0]
    assert session(STALLED, tests=tests)[2] == 0
    _, said, code = session(STALLED, tests=tests, most=0.5)
    assert code == 1 and "1 of 1 tests were not judged, this machine stood still; more than 50%" in said


@pytest.mark.parametrize(
    ("worst", "looks"),
    [((STALLED, STALLED, QUIET), 3), ((QUIET,), 1), ((STALLED,), 4)],
    ids=["soon", "at once", "never"],
)
def test_before_it_repeats_a_session_waits_for_the_machine_but_not_for_ever(
    monkeypatch: pytest.MonkeyPatch, worst: tuple[float, ...], looks: int
):
    now, looked = [0.0], []

    def sleep(seconds: float) -> None:
        now[0] += seconds
        looked.append(seconds)

    late = iter(worst)
    monkeypatch.setattr(standstill, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    monkeypatch.setattr(standstill, "BareTimers", lambda: SimpleNamespace(stop=lambda: report(next(late, worst[-1]))))
    monkeypatch.setattr(standstill, "PATIENCE", 4 * standstill.LOOK)
    stash = pytest.Stash()
    standstill._wait_until_well(stash)
    assert len(looked) == looks
    monkeypatch.setattr(standstill, "PATIENCE_IN_ALL", now[0])
    standstill._wait_until_well(stash)
    assert len(looked) == looks, "all that the session waits for has been waited for"
