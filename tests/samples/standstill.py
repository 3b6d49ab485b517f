"""Whether the machine stood still while a test in real time ran: bare timers beside it tell, as beside a robot's host.

A host of virtual machines that lends a core to others for a second makes a robot's telemetry stale, and no test of a
robot in real time can be judged there. Such a test is run again; where the machine stood still in every attempt that
failed, it is skipped and says for how long, and what failed. One attempt that failed while the machine did not stand
still is a failure, and so are errors of the program's text on any machine, and too many such skips in one session.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from pytest_rerunfailures import get_reruns_count

from motorprior.hardware.machine import BareTimers, MachineReport

LONGEST, SHARE = 0.09, 0.1
"""A machine stands still if a timer woke later than this [s], less than any limit that a robot is tested with, or was
overdue for more than this share of a test."""
MOST = 30
"""Skips of a session: on a machine that spoils more than a quarter of the tests nothing was tested."""
_NEVER = (ImportError, TypeError, NameError, AttributeError, LookupError, SyntaxError)
"""Errors that no machine makes."""
_WATCHED, _SKIPS = pytest.StashKey["_Attempt"](), pytest.StashKey[list[str]]()


class _Attempt:
    """One run of a test, timed from before its first fixture; whether one before failed on a machine that was well."""

    def __init__(self, failed_well: bool):
        self.failed_well, self.reason = failed_well, None
        self._timers, self._begun = BareTimers(), time.monotonic()

    def end(self, failed: bool) -> None:
        """Find out, once, whether the machine stood still."""
        timers, self._timers = self._timers, None
        if timers is not None:
            self.reason = stood_still(timers.stop(), time.monotonic() - self._begun)
        self.failed_well = self.failed_well or (failed and self.reason is None)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Begin to time."""
    if item.get_closest_marker("real_time"):
        before = item.stash.get(_WATCHED, None)
        item.stash[_WATCHED] = _Attempt(before is not None and before.failed_well)
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Make a skip of a failure of the last attempt, where the machine stood still in it and in all before."""
    report, attempt = (yield), item.stash.get(_WATCHED, None)
    if attempt is None or not (report.failed or call.when == "teardown"):
        return report
    attempt.end(report.failed)
    last = getattr(item, "execution_count", 1) > (get_reruns_count(item) or 0)
    if not report.failed or not last or not attempt.reason or attempt.failed_well or call.excinfo is None:
        return report
    if not issubclass(call.excinfo.type, _NEVER):
        said = f"{attempt.reason}; it failed with {call.excinfo.exconly(tryshort=True)[:200]}"
        report.sections.append(("failure on a machine that stood still", str(report.longrepr)))
        report.outcome, report.longrepr = "skipped", (str(item.path), item.location[1] or 0, said)
        item.config.stash.setdefault(_SKIPS, []).append(item.nodeid)
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where next to nothing could be judged."""
    if len(session.config.stash.get(_SKIPS, [])) > MOST:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many were not judged."""
    skips = config.stash.get(_SKIPS, [])
    if skips:
        judged = f"more than {MOST}: the session has failed" if len(skips) > MOST else "run these on a quiet machine"
        terminalreporter.write_line(f"{len(skips)} tests were not judged, this machine stood still; {judged}")


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
