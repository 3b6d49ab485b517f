"""How long a stage took, over all its interruptions, where several stages may run side by side."""

from __future__ import annotations

import time
from pathlib import Path
from threading import Lock
from typing import Any

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError

UNFINISHED = "unfinished.json"
"""Holds the seconds of a stage that was interrupted."""


def seconds_of_same(path: Path, wanted: dict[str, Any]) -> float | None:
    """Seconds in a file of this very stage; None if it is another one's, or none that can be read."""
    try:
        found = read_json(path)
    except ArtifactError:
        return None
    seconds = found.pop("seconds", None) if isinstance(found, dict) else None
    return seconds if found == wanted and is_duration(seconds) else None


def is_duration(seconds: Any) -> bool:
    """Whether a value read from a file can be seconds that something took."""
    return type(seconds) is float and 0.0 <= seconds < 1e12


class SharedTime:
    """Time [s] that passes at 1/n of the clock while n stages run side by side: their seconds add up to the clock's."""

    def __init__(self):
        self._lock, self._running, self._seconds, self._read = Lock(), 0, 0.0, time.monotonic()
        self.busy = 0.0
        """Seconds of the clock with at least one stage."""

    def now(self) -> float:
        """So far."""
        return self.change(0)

    def change(self, more: int) -> float:
        """Let ``more`` stages begin, or end if negative; returns the time."""
        with self._lock:
            now = time.monotonic()
            self._seconds += (now - self._read) / max(1, self._running)
            self.busy += (now - self._read) * (self._running > 0)
            self._read, self._running = now, self._running + more
            return self._seconds


SHARED_TIME = SharedTime()
"""Of this process."""


def seconds_in_stages() -> float:
    """Seconds of this process in which at least one stage was at work: what the seconds of its stages add up to."""
    SHARED_TIME.now()
    return SHARED_TIME.busy


class Stopwatch:
    """Seconds of a stage over all interruptions, see `SharedTime`; a kill loses those since the last `note`."""

    def __init__(self, folder: Path, wanted: dict[str, Any], since: float | None = None):
        """Go on from what an interrupted run of this very stage noted; begin at 0 otherwise.

        Args:
            folder: of the stage.
            wanted: its `description`.
            since: time.monotonic() when the work began; now if not given.
        """
        self._path, self._wanted = folder / UNFINISHED, wanted
        earlier = 0.0 if since is None else time.monotonic() - since
        self._started = SHARED_TIME.now() - earlier
        self._before = seconds_of_same(self._path, wanted) or 0.0

    def seconds(self) -> float:
        """So far."""
        return self._before + SHARED_TIME.now() - self._started

    def note(self) -> None:
        """Write down the seconds so far."""
        write_json(self._path, self._wanted | {"seconds": self.seconds()})
