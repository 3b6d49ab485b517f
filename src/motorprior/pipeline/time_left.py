"""How long many works of about the same length will still take."""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Lock

FINISHED = 1.0
"""A work that takes less [s] was finished by an earlier run, and says nothing about the others."""


class TimeLeft:
    """Time left of ``total`` works, ``threads`` at a time: the mean time of those seen times the number of the others.

    Args:
        total: number of works.
        threads: how many run at a time.
        clock: time [s]; only differences count.
    """

    def __init__(self, total: int, threads: int, clock: Callable[[], float] = time.monotonic):
        self._left, self._threads, self._clock = total, threads, clock
        self._took: list[float] = []
        self._lock = Lock()

    def begun(self) -> float:
        """When a work begins, for `ended`."""
        return self._clock()

    def ended(self, begun: float) -> str:
        """One more is done, which had ``begun`` then; in words what is left, "" before the first that took time."""
        with self._lock:
            self._left -= 1
            took = self._clock() - begun
            if took > FINISHED:
                self._took.append(took)
            if not self._took or self._left == 0:
                return ""
            seconds = sum(self._took) / len(self._took) * self._left / min(self._threads, self._left)
        return f"about {seconds / 60.0:.0f} min left" if seconds >= 90.0 else f"about {seconds:.0f} s left"
