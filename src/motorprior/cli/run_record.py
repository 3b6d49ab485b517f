"""What a demo knows of its run folder: which stages belong to its settings, and how long they took.

``stages.json`` lists the stages that the present settings asked for and found or made finished, with the digests
of their markers. The page shows these only: whatever else lies in the folder is of other settings.
``seconds.json`` holds the seconds of every stage, over all interruptions.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

from motorprior.artifacts import read_json, write_json
from motorprior.cli.stage import MARKER, digest
from motorprior.exceptions import ArtifactError

STAGES, TIMES = "stages.json", "seconds.json"
_FOLDERS = {"bench": "bench", "identify": "priors", "walk": "walk"}
"""Folder of a kind of stage; that of the others has the stage's own name."""
_REST = "everything else"
Result = TypeVar("Result")


def stage_folder(name: str) -> str:
    """``walk rollout_0`` -> ``walk/rollout_0``, ``identify paper`` -> ``priors/paper``, ``validate`` -> itself."""
    kind, _, which = name.partition(" ")
    return f"{_FOLDERS.get(kind, kind)}/{which}" if which else kind


def belongs(run: Path, folder: str) -> bool:
    """Whether a stage's folder, relative to the run folder, holds what the run's present settings ask for."""
    marker = run / folder / MARKER
    try:
        listed = read_json(run / STAGES)
        return isinstance(listed, dict) and marker.is_file() and listed.get(folder) == digest(marker)
    except ArtifactError:  # no list, or one that cannot be read: nothing is known to belong
        return False


class RunRecord:
    """Runs the stages of one demo and keeps both files."""

    def __init__(self, run: Path, settings: Mapping[str, Any], started: float | None = None):
        """Take the folder; from here on no stage belongs to it until it has been asked for.

        Args:
            run: the run folder.
            settings: those of the demo. Seconds of unfinished work count only towards the same ones.
            started: time.monotonic() when the process began, to count imports too; now if not given.
        """
        self._run, self._settings = run, dict(settings)
        self._started = time.monotonic() if started is None else started
        self._seconds = _read_seconds(run / TIMES)
        self._stages: dict[str, str] = {}
        self._here: dict[str, float] = {}
        """Seconds of this process, by stage."""
        self._worked = False
        self._rest = self._seconds.get(_REST)
        write_json(run / STAGES, self._stages)

    def run(self, name: str, work: Callable[[], Result]) -> Result:
        """Run a stage; one that is found finished keeps the time it took then."""
        marker = self._run / stage_folder(name) / MARKER
        before, started = _digest_of(marker), time.monotonic()
        finished = False
        try:
            result = work()
            finished = True
        finally:
            self._here[name] = time.monotonic() - started
            self._count(name, before, _digest_of(marker), finished)
        return result

    def total(self) -> float:
        """Seconds of the stages of these settings, and of imports, pages and checks between them."""
        self._save(finished=True)
        return sum(self._seconds[name]["seconds"] for name in (*self._here, _REST))

    def _count(self, name: str, before: str | None, after: str | None, finished: bool) -> None:
        known, took = self._seconds.get(name), self._here[name]
        found = finished and after is not None and after == before
        if found and known is not None and known["marker"] == after:
            took = known["seconds"]
        else:
            took += self._unfinished(known)
        if not found and (after is not None or not finished):  # a stage without a marker is measured every time
            self._worked = True
        entry = {"seconds": took, "marker": after if finished else None, "finished": finished}
        self._seconds[name] = entry | {"settings": self._settings}
        if finished and after is not None:
            self._stages[stage_folder(name)] = after
            write_json(self._run / STAGES, self._stages)
        self._save(finished=False)

    def _unfinished(self, known: dict[str, Any] | None) -> float:
        """Seconds that an interrupted run of the same settings spent."""
        same = known is not None and not known["finished"] and known["settings"] == self._settings
        return known["seconds"] if same and known is not None else 0.0

    def _save(self, finished: bool) -> None:
        rest = time.monotonic() - self._started - sum(self._here.values())
        known = self._rest
        if known is not None and known["finished"] and known["settings"] == self._settings and not self._worked:
            rest = known["seconds"]
            finished = True
        else:
            rest += self._unfinished(known)
        self._seconds[_REST] = {"seconds": rest, "marker": None, "finished": finished, "settings": self._settings}
        write_json(self._run / TIMES, self._seconds)


def _digest_of(marker: Path) -> str | None:
    return digest(marker) if marker.is_file() else None


def _read_seconds(path: Path) -> dict[str, dict[str, Any]]:
    """The entries that make sense; a damaged file costs the memory of past seconds, and nothing else."""
    try:
        entries = read_json(path)
    except ArtifactError:
        return {}
    return {name: entry for name, entry in entries.items() if _is_entry(entry)} if isinstance(entries, dict) else {}


def _is_entry(entry: Any) -> bool:
    if not isinstance(entry, dict) or entry.keys() != {"seconds", "marker", "finished", "settings"}:
        return False
    seconds = entry["seconds"]
    return type(seconds) in (int, float) and 0 <= seconds < 1e12 and isfinite(seconds)
