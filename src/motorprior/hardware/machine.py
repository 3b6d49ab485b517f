"""The machine beside the control loop: whether it, or the host's own program, made a command late.

Bare timers in processes of their own (`bare_timer.py`), one on each core and four at most, sleep and wake 250 times a
second. Where the host sent nothing for too long and one of them was overdue at the same time, the machine, or that core
of it, stood still; where all were in time, the host's program was slow, or waited for its disk.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.exceptions import RobotFault
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.real_time import TIMER_PRIORITY

_PERIOD, _MOST = 0.004, 4
_PATIENCE = 10.0
"""Longest wait for the reports of timers that were told to end [s]."""
_PAUSED = ("slow host", "watchdog", "stale telemetry")
"""Kinds of faults that a silence of the host can be the reason of."""
_BEFORE, _LEAST = 1.0, 0.05
"""A silence of the host explains a fault if it lies so shortly before it, and lasts so long in all [s]: half of what
the tightest of the limits allows."""
STOOD_STILL = "this machine stood still"
"""In the message of a fault that came of a silence of the whole machine."""
_OURS = "record into memory (a folder in /dev/shm), and let nothing slow run in the control loop"


@dataclass(frozen=True)
class MachineReport:
    """How late bare timers woke; of several, the figures of the worst.

    Attributes:
        wakes: how often all of them did.
        p50: median of how late [s]; p99 and worst alike.
        p99: see p50.
        worst: see p50.
        overdue: of each timer (late wakes, 2), from when to when [s, monotonic clock] it should have been awake and was
            not.
    """

    wakes: int
    p50: float
    p99: float
    worst: float
    overdue: tuple[np.ndarray, ...]


class BareTimers:
    """Running bare timers; of one that does not start or was killed there is no report, and nothing else happens."""

    def __init__(self) -> None:
        self._processes = [process for core in _cores() if (process := _started(core)) is not None]

    def stop(self) -> MachineReport | None:
        """End them; what they found."""
        processes, self._processes = self._processes, []
        for process in processes:
            if process.stdin is not None:
                process.stdin.close()
        give_up = time.monotonic() + _PATIENCE
        found = [one for process in processes if (one := _report(process, give_up)) is not None]
        if not found:
            return None
        p50, p99, worst = (max(one[name] for one in found) for name in ("p50", "p99", "max"))
        late = [np.array(one["late"], dtype=np.float64).reshape(-1, 2) for one in found]
        overdue = tuple(np.stack([one[:, 0], one.sum(axis=1)], axis=1) for one in late)
        return MachineReport(sum(one["wakes"] for one in found), p50, p99, worst, overdue)


def _cores() -> list[int]:
    """Numbers of the first cores that this process may use; -1, any one, where the system does not say."""
    return sorted(os.sched_getaffinity(0))[:_MOST] if hasattr(os, "sched_getaffinity") else [-1]


def _started(core: int) -> subprocess.Popen[bytes] | None:
    script = str(Path(__file__).with_name("bare_timer.py"))
    command = [sys.executable, "-I", "-S", script, str(_PERIOD), str(TIMER_PRIORITY), str(core)]
    try:
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    except OSError:
        return None


def _report(process: subprocess.Popen[bytes], give_up: float) -> dict[str, Any] | None:
    """What a timer whose input has ended says, until ``give_up`` [s] on the monotonic clock."""
    assert process.stdout is not None, "a pipe"
    with process, contextlib.suppress(ValueError):
        ready, _, _ = select.select([process.stdout], [], [], max(0.0, give_up - time.monotonic()))
        if not ready:
            process.kill()
        found = json.loads(process.stdout.read())
        return found if found["wakes"] else None
    return None


def silences(timing: Timing, period: float) -> np.ndarray:
    """(silences, 2) from when to when [s] the host sent nothing although a command was due, for half a period or more.

    Args:
        timing: of a motion that has ended.
        period: [s]; a command is due one after the one before.
    """
    times = np.array([*timing.sent, *([] if timing.ended is None else [timing.ended])])
    long = np.flatnonzero(np.diff(times) > 1.5 * period)
    return np.stack([times[long] + period, times[long + 1]], axis=1)


def with_the_machine(pauses: np.ndarray, overdue: tuple[np.ndarray, ...]) -> float:
    """Time [s] of intervals (n, 2) in which a timer was overdue: in each of them, the timer that was most of all."""
    return float(np.max([_overlaps(pauses, one) for one in overdue], axis=0, initial=0.0).sum())


def _overlaps(ours: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(n,) of each interval (n, 2) the time [s] that it has in common with others (m, 2), which do not overlap."""
    begins, ends = np.maximum(ours[:, None, 0], others[None, :, 0]), np.minimum(ours[:, None, 1], others[None, :, 1])
    return np.clip(ends - begins, 0.0, None).sum(axis=1)


def machine_facts(report: MachineReport, timing: Timing, period: float) -> dict[str, float]:
    """For a reader of a run: how late the timer was, and how long the host was silent, with and without the machine."""
    pauses = silences(timing, period)
    lengths = pauses[:, 1] - pauses[:, 0]
    seconds = {
        "timer_late_ms/p50": report.p50,
        "timer_late_ms/p99": report.p99,
        "timer_late_ms/max": report.worst,
        "silent_ms": float(lengths.sum()),
        "silent_ms/max": float(lengths.max(initial=0.0)),
        "silent_ms/with_the_machine": with_the_machine(pauses, report.overdue),
    }
    return {"timer_wakes": float(report.wakes), **{name: 1e3 * value for name, value in seconds.items()}}


def explained(fault: RobotFault, report: MachineReport | None, timing: Timing, period: float) -> RobotFault:
    """The fault; where a silence of the host came before it, with whether the machine or the program was the reason.

    Of a fault that did not end the timed motion, but came on the way up or down, nothing is known.
    """
    if report is None or fault.kind not in _PAUSED or timing.ended is None or timing.fault != fault.kind:
        return fault
    pauses = np.clip(silences(timing, period), timing.ended - _BEFORE, timing.ended)
    silent, machine = float(np.diff(pauses).sum()), with_the_machine(pauses, report.overdue)
    if silent < _LEAST:
        return fault
    who = STOOD_STILL if machine >= 0.5 * silent else "this program was slow, the machine was not"
    return RobotFault(
        fault.kind,
        f"{fault.problem}; {who}: in the second before, commands were overdue for {1e3 * silent:.0f} ms, and for "
        f"{1e3 * machine:.0f} ms of these a timer in a process of its own was overdue, too",
        safe_state=fault.safe_state,
        remedy=fault.remedy if machine >= 0.5 * silent else _OURS,
        argument=fault.argument,
    )
