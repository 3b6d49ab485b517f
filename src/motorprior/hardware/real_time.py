"""Scheduling of a process with deadlines: real-time priority where it is permitted, and no garbage collection."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager

_REAL_TIME = (1, 10)
"""SCHED_FIFO and its priority; the watchdog's is higher."""


@contextmanager
def real_time_priority() -> Iterator[None]:
    """SCHED_FIFO for this thread, and what it starts, where this user may have it; otherwise nothing changes."""
    before = _set_policy(_REAL_TIME)
    try:
        yield
    finally:
        if before is not None:
            _set_policy(before)


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
