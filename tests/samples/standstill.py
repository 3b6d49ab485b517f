"""Whether the machine stood still while a test in real time ran: bare timers beside it tell, as beside a robot's host.

A host of virtual machines that lends a core to others for a second makes a robot's telemetry stale, and no test of a
robot in real time can be judged there. Such a test is run again; where it never passes, but the machine stood still in
(nearly) every attempt, it is skipped and says for how long, and what failed. The next attempt waits a while for the
machine to be well again. On a machine that did not stand still the test has failed, and so have errors of the program's
text on any machine, and a session with too many such skips.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from pytest_rerunfailures import get_reruns_count

from motorprior.hardware.machine import BareTimers, MachineReport

LONGEST = 0.09
"""A machine stands still if a timer wakes later than this [s]."""
SHARE = 0.1
"""It does, too, if a timer is overdue for more than this share of a test."""
SHORT = 0.005
"""Lateness [s] that does not count for the share: any busy machine has it."""
WELL = 4
"""One attempt in so many may fail while the machine did not stand still: a fault of the program fails in all."""
MOST = 0.5
"""Share of the tests in real time that may be skipped: on a machine that spoils more of them little was tested."""
LOOK, PATIENCE, PATIENCE_IN_ALL = 2.0, 20.0, 240.0
"""Before it repeats what the machine spoiled, a session looks for so long [s] whether it is well, waits for that for so
long, and so long for all its tests together."""
_NEVER = (ImportError, NameError, SyntaxError)
"""Errors that no machine makes."""
_TIMERS, _REASONS, _SKIPS, _RUN, _WAITED = (
    pytest.StashKey["_Timed | None"](),
    pytest.StashKey[list[str | None]](),
    pytest.StashKey[set[str]](),
    pytest.StashKey[set[str]](),
    pytest.StashKey[float](),
)


class _Timed:
    """One attempt, timed from before its first fixture."""

    def __init__(self):
        self._timers, self._begun = BareTimers(), time.monotonic()

    def end(self) -> str | None:
        """How the machine spoiled it; None if it did not."""
        duration, report = time.monotonic() - self._begun, self._timers.stop()
        return stood_still(report, duration)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Begin to time, after what the machine spoiled not before it is well again."""
    if item.get_closest_marker("real_time"):
        item.config.stash.setdefault(_RUN, set()).add(item.nodeid)
        if any(item.stash.get(_REASONS, [])[-1:]):
            _wait_until_well(item.config.stash)
        item.stash[_TIMERS] = _Timed()
    return (yield)


def _wait_until_well(stash: pytest.Stash) -> None:
    begun, waited = time.monotonic(), stash.get(_WAITED, 0.0)
    give_up = begun + min(PATIENCE, PATIENCE_IN_ALL - waited)
    while time.monotonic() < give_up:
        timed = _Timed()
        time.sleep(LOOK)
        if timed.end() is None:
            break
    stash[_WAITED] = waited + time.monotonic() - begun


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo) -> Iterator[None]:
    """Make a skip of the failure of the last attempt, where the machine stood still in (nearly) all of them."""
    report, timed = (yield), item.stash.get(_TIMERS, None)
    if not item.get_closest_marker("real_time") or not (report.failed or call.when == "teardown"):
        return report
    reasons = item.stash.setdefault(_REASONS, [])
    if timed is not None:  # at the teardown of a test that failed the attempt has been judged
        item.stash[_TIMERS], reason = None, timed.end()
        if report.failed:
            reasons.append(reason)
    if not report.failed:
        return report
    last = getattr(item, "execution_count", 1) > (get_reruns_count(item) or 0)
    if last and call.excinfo is not None and _is_excused(reasons) and not issubclass(call.excinfo.type, _NEVER):
        told = next(one for one in reversed(reasons) if one is not None)
        said = f"{told}; the last failed with {call.excinfo.exconly(tryshort=True)[:200]}"
        report.sections.append(("failure on a machine that stood still", str(report.longrepr)))
        report.outcome, report.longrepr = "skipped", (str(item.path), item.location[1] or 0, said)
        item.config.stash.setdefault(_SKIPS, set()).add(item.nodeid)
    return report


def _is_excused(reasons: list[str | None]) -> bool:
    return reasons.count(None) <= len(reasons) // WELL and any(reasons)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail where too little could be judged."""
    if _judged_too_little(session.config):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _judged_too_little(config: pytest.Config) -> bool:
    return len(config.stash.get(_SKIPS, ())) > MOST * len(config.stash.get(_RUN, ()))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Say how many were not judged."""
    skips = config.stash.get(_SKIPS, ())
    if skips:
        said = (
            f"more than {MOST:.0%}: the session has failed" if _judged_too_little(config) else "run them on a quiet one"
        )
        every = len(config.stash[_RUN])
        terminalreporter.write_line(f"{len(skips)} of {every} tests were not judged, this machine stood still; {said}")


def stood_still(machine: MachineReport | None, duration: float) -> str | None:
    """How the machine spoiled an attempt of ``duration`` [s]; None if it did not, or nobody timed it."""
    if machine is None:
        return None
    late = [np.diff(each).ravel() for each in machine.overdue]
    overdue = max((float(each[each > SHORT].sum()) for each in late), default=0.0)
    if machine.worst <= LONGEST and overdue <= SHARE * duration:
        return None
    return (
        f"not judged: this machine stood still for up to {1e3 * machine.worst:.0f} ms in an attempt, and for "
        f"{1e3 * overdue:.0f} ms of its {duration:.1f} s in all"
    )
