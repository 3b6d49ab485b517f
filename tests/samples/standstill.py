"""Whether the machine stood still while a test in real time ran: bare timers beside it tell, as beside a robot's host.

A host of virtual machines that lends a core to others for a second makes a robot's telemetry stale, and no test of a
robot in real time can be judged there. Such a test is run again; where the machine stood still in the last attempt,
too, it is skipped and says for how long. A failure on a machine that did not stand still stays a failure.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest

from motorprior.hardware.machine import BareTimers, MachineReport

LONGEST, SHARE = 0.05, 0.05
"""A machine stands still if a timer woke later than this [s], or was overdue for more than this share of a test."""
_WATCHED = pytest.StashKey["_Attempt"]()


class _Attempt:
    """One run of a test, timed from before its first fixture."""

    def __init__(self, number: int):
        self.number, self._timers, self._begun = number, BareTimers(), time.monotonic()
        self.reason: str | None = None

    def end(self) -> None:
        """Find out, once, whether the machine stood still."""
        timers, self._timers = self._timers, None
        if timers is not None:
            self.reason = stood_still(timers.stop(), time.monotonic() - self._begun)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Begin to time."""
    if item.get_closest_marker("real_time"):
        before = item.stash.get(_WATCHED, None)
        item.stash[_WATCHED] = _Attempt(1 if before is None else before.number + 1)
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Make a skip of a failure of the last attempt, where the machine stood still in it."""
    report, attempt = (yield), item.stash.get(_WATCHED, None)
    if attempt is None or not (report.failed or call.when == "teardown"):
        return report
    attempt.end()
    chances, is_last = item.get_closest_marker("flaky"), True
    if chances is not None:
        is_last = attempt.number > chances.kwargs["reruns"]
    if report.failed and is_last and attempt.reason:
        report.outcome, report.longrepr = "skipped", (str(item.path), item.location[1] or 0, attempt.reason)
    return report


def stood_still(machine: MachineReport | None, duration: float) -> str | None:
    """How the machine spoiled a test of ``duration`` [s]; None if it did not, or nobody timed it."""
    if machine is None:
        return None
    overdue = max((float(np.diff(each).sum()) for each in machine.overdue), default=0.0)
    if machine.worst <= LONGEST and overdue <= SHARE * duration:
        return None
    return (
        f"not judged: this machine stood still for up to {1e3 * machine.worst:.0f} ms in the last attempt, and for "
        f"{1e3 * overdue:.0f} ms of its {duration:.1f} s in all"
    )
