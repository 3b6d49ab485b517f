"""A stage of work in a folder: finished or not, and whether what is there is what is asked for.

``stage.json`` is written last. It holds the resolved settings, the contents of the recipe, the digests of the
inputs and of the code, the version, and the seconds that the stage took, its share of them where several stages ran
side by side; a stage whose file says the same, whatever its seconds, is not run again, so an interrupted demo continues
where it stopped. No path is part of it: a folder that was moved or copied is still finished.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

from motorprior import __version__
from motorprior.artifacts import read_json, remove_half_written, write_json
from motorprior.bench.fleet import fleet_path
from motorprior.exceptions import ArtifactError
from motorprior.pipeline.folder_lock import taken
from motorprior.results import Results
from motorprior.robots.robot import Robot

RESULTS, FIGURES = "results.json", "figures.json"
MARKER, UNFINISHED = "stage.json", "unfinished.json"
"""The second holds the seconds of a stage that was interrupted."""
_STAGES = (
    "bench",
    "calibrate",
    "identify",
    "adapt",
    "validate",
    "simulate",
    "replay",
    "real_motors",
    "walk",
    "transfer",
    "study",
)
_NEEDS = {"validate": ("adapt",), "real_motors": ("adapt", "identify"), "study": ("transfer",)}
"""Stages whose own module another one's numbers depend on."""
_PARTS = {"study": ("study_watch",), "walk": ("training", "trained_policy")}
"""Modules that belong to one stage."""
_NO_NUMBERS = (
    *("report/*", "hardware/*", "cli/*", "environments.py", "__main__.py"),
    *(
        f"pipeline/{name}.py"
        for name in (
            "progress",
            "time_left",
            "side_by_side",
            "stage",
            "folder_lock",
            "demo",
            "demo_settings",
            "report",
            "speed",
        )
    ),
    *("pipeline/train_policy.py", "pipeline/comparison.py", "pipeline/tensorboard.py"),
    *(f"pipeline/{name}.py" for name in ("study_settings", "study_conditions", "study_report")),
    *(
        f"transfer/{name}.py"
        for name in ("statistics", "study_summary", "study_verdicts", "study_claims", "study_results")
    ),  # judges
    *(
        f"pipeline/{name}.py"
        for name in ("play", "walk_film", "schedule_file", "robustness", "walk_report", "walk_metrics", "walk_seeds")
    ),
    *("simulation/render*.py", "simulation/viewer.py", "simulation/camera.py"),
    *("pipeline/virtual_robot.py", "pipeline/twin_body.py", "simulation/live_robot.py"),
)
"""What no stage computes with; a robot, real or virtual, is not part of any."""


def digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        ArtifactError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ArtifactError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def description(
    name: str, settings: Mapping[str, Any], inputs: Sequence[Path], recipe: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a stage was asked to do, as JSON.

    Args:
        name: of the stage; its module in `motorprior.pipeline` has the same.
        settings: resolved options; paths among them are left out, `inputs` speaks for them.
        inputs: every file that the stage reads, in a fixed order; counts by name and content.
        recipe: contents of the preset that an option names.
    """
    return {
        "stage": name,
        "version": __version__,
        "code": code_digest(name),
        "config": _plain(settings),
        "recipe": _plain(recipe or {}),
        "inputs": [f"{path.name} {digest(path)}" for path in inputs],
    }


@cache
def code_digest(stage: str) -> str:
    """SHA-256 of the modules that the results of a stage can depend on, shortened."""
    return package_digest(stage, Path(__file__).parents[1])


def package_digest(stage: str, package: Path) -> str:
    """`code_digest` of the package in some folder."""
    needed = (stage, *_NEEDS.get(stage, ()))
    others = [
        f"pipeline/{name}.py" for other in _STAGES if other not in needed for name in (other, *_PARTS.get(other, ()))
    ]
    parts = []
    for path in sorted(package.rglob("*.py")):
        inner = path.relative_to(package)
        if not any(inner.match(pattern) for pattern in (*_NO_NUMBERS, *others)):
            parts.append(f"{inner.as_posix()} {digest(path)}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def fleet_files(robot: Robot, fleet: str | None) -> list[Path]:
    """The file of a fleet, shipped or given by path; the robot's own if none is named.

    Raises:
        ArtifactError, ConfigError: there is none.
    """
    return [fleet_path(robot.default_fleet if fleet is None else fleet)]


def write_results(folder: Path, results: Results) -> None:
    """Keep what a stage measured: as rows for the library, as figures by name for everybody else."""
    results.save(folder / RESULTS)
    write_json(folder / FIGURES, results.to_figures())


def read_results(folder: Path) -> Results:
    """What a finished stage measured.

    Raises:
        ArtifactError: missing or damaged.
    """
    return Results.load(folder / RESULTS)


def _plain(value: Any) -> Any:
    """JSON values without paths; a fleet's file counts by its content, so its place is left out too."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if not _is_place(item)}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value if not _is_place(item)]
    return value


def _is_place(value: Any) -> bool:
    return isinstance(value, Path) or (isinstance(value, str) and value.endswith(".toml"))


def is_finished(folder: Path, wanted: dict[str, Any]) -> bool:
    """Whether ``folder`` holds the result of exactly this stage."""
    return _seconds_of(folder / MARKER, wanted) is not None


def seconds_of(folder: Path) -> float:
    """Seconds of the finished stage in ``folder``, see `Stopwatch`.

    Raises:
        ArtifactError: no finished stage, or a damaged marker.
    """
    marker = read_json(folder / MARKER)
    seconds = marker.get("seconds") if isinstance(marker, dict) else None
    if seconds is None or not _is_duration(seconds):
        raise ArtifactError("it does not say how long the stage took", where=folder / MARKER, remedy="run it again")
    return seconds


def _seconds_of(path: Path, wanted: dict[str, Any]) -> float | None:
    """Seconds in a file of this very stage; None if it is another one's, or none that can be read."""
    try:
        found = read_json(path)
    except ArtifactError:
        return None
    seconds = found.pop("seconds", None) if isinstance(found, dict) else None
    return seconds if found == wanted and _is_duration(seconds) else None


def _is_duration(seconds: Any) -> bool:
    return type(seconds) is float and 0.0 <= seconds < 1e12


class _SharedTime:
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


_SHARED_TIME = _SharedTime()


def seconds_in_stages() -> float:
    """Seconds of this process in which at least one stage was at work: what the seconds of its stages add up to."""
    _SHARED_TIME.now()
    return _SHARED_TIME.busy


class Stopwatch:
    """Seconds of a stage over all interruptions, see `_SharedTime`; a kill loses those since the last `note`."""

    def __init__(self, folder: Path, wanted: dict[str, Any], since: float | None = None):
        """Go on from what an interrupted run of this very stage noted; begin at 0 otherwise.

        Args:
            folder: of the stage.
            wanted: its `description`.
            since: time.monotonic() when the work began; now if not given.
        """
        self._path, self._wanted = folder / UNFINISHED, wanted
        earlier = 0.0 if since is None else time.monotonic() - since
        self._started = _SHARED_TIME.now() - earlier
        self._before = _seconds_of(self._path, wanted) or 0.0

    def seconds(self) -> float:
        """So far."""
        return self._before + _SHARED_TIME.now() - self._started

    def note(self) -> None:
        """Write down the seconds so far."""
        write_json(self._path, self._wanted | {"seconds": self.seconds()})


@contextmanager
def working(folder: Path, wanted: dict[str, Any], since: float | None = None) -> Iterator[Stopwatch]:
    """Take the folder of a stage: while this is open it is unfinished, and finished once it closes without an error.

    Args:
        folder: where the stage writes.
        wanted: its `description`.
        since: time.monotonic() when the work began; now if not given.

    Raises:
        ArtifactError: the folder cannot be created or written, or another process or thread writes there.
    """
    with taken(folder):
        begin(folder)
        clock = Stopwatch(folder, wanted, since)
        _SHARED_TIME.change(1)
        try:
            yield clock
            seconds = clock.seconds()
        except KeyboardInterrupt:
            clock.note()
            raise
        finally:
            _SHARED_TIME.change(-1)
        write_json(folder / MARKER, wanted | {"seconds": seconds})
        remove(folder, UNFINISHED)


def remove(folder: Path, name: str) -> None:
    """Remove a file that only an unfinished stage needs."""
    (folder / name).unlink(missing_ok=True)


def begin(folder: Path) -> None:
    """Begin anew in a folder: what was finished in it no longer is, and what killed processes half wrote goes.

    Raises:
        ArtifactError: it cannot be created or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MARKER).unlink(missing_ok=True)
        remove_half_written(folder)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ArtifactError(
            f"cannot write there ({error.strerror})", where=folder, remedy="choose another folder"
        ) from error
