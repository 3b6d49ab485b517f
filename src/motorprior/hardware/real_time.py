"""Protection of the control loop from other processes, paging and garbage collection, where the system permits it."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_PRIORITY = 10  # of SCHED_FIFO; the watchdog's is higher
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # flags of mlockall(2)


@contextmanager
def real_time() -> Iterator[dict[str, bool]]:
    """Real-time priority, locked memory and no garbage collection while this is open; yields what was permitted."""
    normal = _set_scheduler(1, _PRIORITY)  # SCHED_FIFO
    libc = ctypes.CDLL(None) if _may_lock_memory() else None
    locked = libc is not None and libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0
    collects = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield {"real_time_priority": normal is not None, "memory_locked": locked}
    finally:
        gc.unfreeze()
        if collects:
            gc.enable()
        if locked and libc is not None:
            libc.munlockall()
        if normal is not None:
            _set_scheduler(*normal)


def _may_lock_memory() -> bool:
    """Only without any limit: within one, a later allocation would fail in the middle of a motion."""
    if sys.platform != "linux":
        return False
    import resource

    return resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY


def _set_scheduler(policy: int, priority: int) -> tuple[int, int] | None:
    """Set scheduling policy and priority of this thread; returns the earlier ones, None if not permitted."""
    if not hasattr(os, "sched_setscheduler"):  # not Linux
        return None
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError:
        return None
    return before
