"""A timer that does nothing else: how late this machine wakes a process that only sleeps. `machine.py` starts it.

    python -I -S bare_timer.py PERIOD PRIORITY CORE

CORE is the number of the core it stays on, or -1 for any. It uses the standard library only, and real-time priority
where it may, above the control loop's. It ends when its standard input does, also by the death of the host, and then
writes a JSON map: "wakes"; "p50", "p99" and "max" of how late they were [s]; "late": the last `_KEPT` that were later
than `_LATE`, as pairs of when each was due [s, monotonic clock] and how late it came [s].
"""

import contextlib
import gc
import json
import os
import select
import signal
import sys
import time
from array import array
from collections import deque

_LATE = 0.002
_KEPT = 50_000
_BIN, _BINS = 1e-5, 10_000
"""Width of the histogram's bins [s], and their number; what is later is in the last one."""


def main(arguments: list[str]) -> None:
    """Time until the standard input ends, then report."""
    period, priority, core = float(arguments[0]), int(arguments[1]), int(arguments[2])
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGPIPE):
        signal.signal(ignored, signal.SIG_IGN)
    with contextlib.suppress(OSError, AttributeError):  # needs a right, and a system that has it
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    if core >= 0:
        with contextlib.suppress(OSError, AttributeError):  # the core was taken away, or there is no such call
            os.sched_setaffinity(0, {core})
    gc.disable()
    report = json.dumps(measure(period, sys.stdin.fileno()))
    with contextlib.suppress(OSError):  # nobody is there any more
        print(report, flush=True)


def measure(period: float, stop: int) -> dict:
    """Sleep and wake every ``period`` [s] until the file ``stop`` ends or has bytes."""
    counts, late_ones, worst = array("Q", bytes(8 * (_BINS + 1))), deque(maxlen=_KEPT), 0.0
    due, ends = time.monotonic() + period, False
    while not ends:
        ends = bool(select.select([stop], [], [], max(0.0, due - time.monotonic()))[0])
        late = max(0.0, time.monotonic() - due)
        if ends and late == 0.0:
            break  # it was to end, and nothing was due
        counts[min(_BINS, int(late / _BIN))] += 1
        worst = max(worst, late)
        if late > _LATE:
            late_ones.append((due, late))
        due += period * (1 + late // period)
    quantiles = {f"p{share}": _quantile(counts, 0.01 * share) for share in (50, 99)}
    return {"wakes": sum(counts), **quantiles, "max": worst, "late": list(late_ones)}


def _quantile(counts: array, share: float) -> float:
    """Upper end of the bin [s] up to which lie ``share`` of all."""
    left = share * sum(counts)
    for number, count in enumerate(counts):
        left -= count
        if left <= 0.0:
            return _BIN * (number + 1)
    return _BIN * len(counts)


if __name__ == "__main__":
    main(sys.argv[1:])
