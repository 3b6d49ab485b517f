"""Whether the machine or the host's program was late is found out beside the run, and said."""

import os
import signal
import subprocess
import sys
import threading
import time
from array import array
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import RobotFault
from motorprior.hardware import machine, real_time
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.machine import BareTimers, MachineReport, explained, machine_facts, silences, with_the_machine
from motorprior.hardware.real_time import granted, locked_memory, real_time_priority

PERIOD = 0.01


def a_run(*gaps: float, ended_after: float = 0.01, fault: str = "slow host") -> Timing:
    """Commands with so much time between them [s], from 100 s on."""
    sent = 100.0 + np.cumsum([0.0, *gaps])
    return Timing(sent=array("d", sent.tolist()), ended=float(sent[-1] + ended_after), fault=fault)


def a_report(*overdue: tuple[float, float]) -> MachineReport:
    return MachineReport(1000, 3e-5, 2e-4, 0.08, (np.array(overdue).reshape(-1, 2), np.empty((0, 2))))


def slow_host() -> RobotFault:
    return RobotFault("slow host", "a control step came 70 ms late", safe_state="crouch", remedy="close other programs")


def test_a_silence_lasts_from_when_a_command_was_due_to_the_next_one():
    found = silences(a_run(0.01, 0.08, 0.012, 0.01, ended_after=0.03), PERIOD)
    np.testing.assert_allclose(found, [[100.02, 100.09], [100.122, 100.142]])
    assert silences(a_run(0.01, 0.01), PERIOD).shape == silences(Timing(), PERIOD).shape == (0, 2)


def test_the_time_that_silences_share_with_the_machine_equals_arithmetic():
    ours, one = np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([[0.5, 2.25], [2.5, 9.0], [10.0, 11.0]])
    assert with_the_machine(ours, (one,)) == pytest.approx(0.5 + 0.25 + 0.5)
    other = np.array([[0.1, 0.9]])  # the core that the loop was on in the first silence
    assert with_the_machine(ours, (one, other)) == pytest.approx(0.8 + 0.75)
    assert with_the_machine(ours, ()) == with_the_machine(np.empty((0, 2)), (one,)) == 0.0


def test_a_silence_in_which_the_timer_was_overdue_too_is_the_machine_s():
    run = a_run(0.01, 0.08)
    told = explained(slow_host(), a_report((90.0, 90.5), (100.021, 100.089)), run, PERIOD)
    assert "this machine stood still" in str(told) and "overdue for 70 ms, and for 68 ms" in str(told)
    assert (told.kind, told.safe_state, told.remedy) == ("slow host", "crouch", "close other programs")


def test_a_silence_in_which_the_timer_was_in_time_is_the_program_s():
    told = explained(slow_host(), a_report((90.0, 90.5)), a_run(0.01, 0.08), PERIOD)
    assert "this program was slow" in str(told) and "70 ms, and for 0 ms" in str(told)
    assert told.remedy is not None and "into memory" in told.remedy


@pytest.mark.parametrize(
    ("fault", "report", "run"),
    [
        (RobotFault("stale telemetry", "0.11 s old"), a_report(), a_run(0.01, 0.01, fault="stale telemetry")),
        (RobotFault("fall", "roll +0.8 rad"), a_report((100.0, 100.1)), a_run(0.01, 0.08, fault="fall")),
        (RobotFault("stale telemetry", "0.11 s old"), a_report((100.0, 100.1)), a_run(0.016, fault="stale telemetry")),
        (slow_host(), a_report((100.0, 100.1)), a_run(0.01, 0.08, fault="")),
        (slow_host(), None, a_run(0.01, 0.08)),
        (slow_host(), a_report((100.0, 100.1)), Timing()),
    ],
    ids=["a silent robot", "another fault", "a short silence", "on the way down", "no timer", "no motion"],
)
def test_nothing_is_said_where_no_silence_of_the_host_explains_it(
    fault: RobotFault, report: MachineReport | None, run: Timing
):
    assert explained(fault, report, run, PERIOD) is fault


def test_the_facts_of_a_run_hold_the_timer_and_the_silences():
    facts = machine_facts(a_report((100.02, 100.05)), a_run(0.01, 0.08, 0.01, 0.04), PERIOD)
    assert facts["silent_ms"] == pytest.approx(100.0) and facts["silent_ms/max"] == pytest.approx(70.0)
    assert facts["silent_ms/with_the_machine"] == pytest.approx(30.0)
    assert (facts["timer_wakes"], facts["timer_late_ms/max"]) == (1000.0, pytest.approx(80.0))


def timers_of_which_one_is_stopped() -> tuple[BareTimers, int]:
    """To a timer, being stopped is what a core that stands still is; its process number."""
    timers = BareTimers()
    time.sleep(0.5)
    stopped_one = timers._processes[0].pid
    os.kill(stopped_one, signal.SIGSTOP)
    return timers, stopped_one


@pytest.mark.real_time
def test_a_timer_that_could_not_run_was_overdue_for_as_long():
    timers, stopped_one = timers_of_which_one_is_stopped()
    stopped = time.monotonic()
    time.sleep(0.2)
    begun = time.monotonic()
    os.kill(stopped_one, signal.SIGCONT)
    time.sleep(0.1)
    report = timers.stop()
    assert report is not None and report.wakes > 10 and report.p50 <= report.p99 <= report.worst
    assert with_the_machine(np.array([[stopped, begun]]), report.overdue) > 0.9 * (begun - stopped)
    assert report.worst >= 0.9 * (begun - stopped)


@pytest.mark.real_time
def test_a_timer_that_is_told_to_end_while_it_cannot_run_was_overdue_until_then():
    """A test that a standstill spoils ends before the standstill does."""
    timers, stopped_one = timers_of_which_one_is_stopped()
    later = threading.Timer(0.2, os.kill, (stopped_one, signal.SIGCONT))
    later.start()
    report = timers.stop()
    later.join()
    assert report is not None and report.worst > 0.15


@pytest.mark.real_time
@pytest.mark.skipif(not granted()["real_time_priority"], reason="this user may not have real-time priority")
def test_a_program_that_computes_for_too_long_keeps_no_timer_from_waking():
    """In real time, too: what it takes is its own, not the machine's."""
    core = {sorted(os.sched_getaffinity(0))[0]}
    everywhere = os.sched_getaffinity(0)
    timers = BareTimers()
    time.sleep(0.5)
    spins = []
    with real_time_priority():
        os.sched_setaffinity(0, core)
        try:
            for _ in range(6):
                begun = time.monotonic()
                while time.monotonic() < begun + 0.1:
                    pass
                spins.append([begun, time.monotonic()])
                time.sleep(0.05)
        finally:
            os.sched_setaffinity(0, everywhere)
    report = timers.stop()
    assert report is not None
    assert with_the_machine(np.array(spins), report.overdue) < 0.25 * float(np.diff(spins).sum())


@pytest.mark.real_time
def test_timers_that_are_gone_leave_no_report_and_no_error(monkeypatch: pytest.MonkeyPatch):
    timers = BareTimers()
    for process in timers._processes:
        process.kill()
    assert timers.stop() is None and timers.stop() is None
    monkeypatch.setattr(machine.sys, "executable", "/no/such/python")
    assert BareTimers().stop() is None


@pytest.mark.real_time
def test_timers_end_with_the_host():
    """However it ends: their input does."""
    code = "from motorprior.hardware.machine import BareTimers; t = BareTimers(); "
    code += "print(*[p.pid for p in t._processes], flush=True); input()"
    host = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert host.stdout is not None
    pids = [int(word) for word in host.stdout.readline().split()]
    host.kill()
    host.communicate()
    give_up = time.monotonic() + 10.0
    while any(
        Path(f"/proc/{pid}/cmdline").is_file() and b"bare_timer" in Path(f"/proc/{pid}/cmdline").read_bytes()
        for pid in pids
    ):
        assert time.monotonic() < give_up, "still there"
        time.sleep(0.01)
    assert pids


def locked_kilobytes() -> int:
    with open("/proc/self/status", encoding="ascii") as status:
        return int(next(line.split()[1] for line in status if line.startswith("VmLck:")))


@pytest.mark.skipif(not granted()["memory_locked"], reason="this user may not lock memory")
def test_memory_is_locked_meanwhile_and_no_longer():
    with locked_memory() as locked:
        assert locked and locked_kilobytes() > 0
    assert locked_kilobytes() == 0


def test_memory_is_not_locked_within_a_limit_that_later_allocations_could_reach(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(real_time, "_may_lock_all", lambda: False)
    with locked_memory() as locked:
        assert not locked and not granted()["memory_locked"]
