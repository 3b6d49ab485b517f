"""Protection of the control loop from other processes, paging and garbage collection, where the system permits it."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SCHED_FIFO, _PRIORITY = 1, 10  # the watchdog's priority is higher
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # flags of mlockall(2)


@contextmanager
def real_time() -> Iterator[None]:
    """Real-time priority, locked memory and no garbage collection within this context."""
    normal = _set_scheduler(_SCHED_FIFO, _PRIORITY)
    # With a limit of locked memory, a later allocation would fail in the middle of a motion.
    unlimited = sys.platform == "linux" and resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    libc = ctypes.CDLL(None) if unlimited else None
    if libc is not None:
        libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT)
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        if libc is not None:
            libc.munlockall()
        if normal is not None:
            _set_scheduler(*normal)


def _set_scheduler(policy: int, priority: int) -> tuple[int, int] | None:
    """Set scheduling policy and priority of this thread; returns the earlier ones, None if not permitted."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except (OSError, AttributeError):  # not permitted, or not Linux
        return None
    return before
