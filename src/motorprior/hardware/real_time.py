"""What disturbs a process with deadlines, and is kept from it: other processes, paging, garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY, TIMER_PRIORITY = 10, 15
"""Of SCHED_FIFO, number 1: the control loop's, and that of the timers beside it, which a loop that computes for too
long must not keep from waking. The watchdog's is higher than both."""
_SCHED_FIFO = 1
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
"""Flags of mlockall(2): the pages that are there, those to come, each not before it is touched."""
_MAY_LOCK = 1 << 14
"""CAP_IPC_LOCK, see capabilities(7)."""


@contextmanager
def real_time_priority() -> Iterator[bool]:
    """SCHED_FIFO for this thread, and what it starts, where this user may have it; otherwise nothing changes.

    Gives whether it is had.
    """
    before = _set_policy((_SCHED_FIFO, PRIORITY))
    try:
        yield before is not None
    finally:
        if before is not None:
            _set_policy(before)


@contextmanager
def locked_memory() -> Iterator[bool]:
    """Keep this process' memory from being paged out, where this user may lock as much as it wants.

    A lock within a limit would make a later allocation fail, in the middle of a motion. Gives whether it is locked.
    """
    libc = ctypes.CDLL(None, use_errno=True) if _may_lock_all() else None
    locked = libc is not None and libc.mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0
    try:
        yield locked
    finally:
        if locked and libc is not None:
            libc.munlockall()


def granted() -> dict[str, bool]:
    """What of the above this user may have."""
    with real_time_priority() as priority, locked_memory() as locked:
        return {"real_time_priority": priority, "memory_locked": locked}


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Collect no garbage while this is open; what exists before is frozen."""
    was_enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def _may_lock_all() -> bool:
    """On Linux, by a limit that is none or by the capability."""
    try:
        import resource

        if resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY:
            return sys.platform == "linux"
        with open("/proc/self/status", encoding="ascii") as status:
            capabilities = next(line.split()[1] for line in status if line.startswith("CapEff:"))
    except (ImportError, AttributeError, OSError, ValueError, StopIteration):
        return False
    return bool(int(capabilities, 16) & _MAY_LOCK)


def _set_policy(wanted: tuple[int, int]) -> tuple[int, int] | None:
    """Scheduling policy and priority from now on; what they were, or None where it may not."""
    if not hasattr(os, "sched_setscheduler"):  # not Linux
        return None
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    try:
        os.sched_setscheduler(0, wanted[0], os.sched_param(wanted[1]))
    except OSError:
        return None
    return before
