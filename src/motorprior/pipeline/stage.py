"""A stage of work in a folder: finished or not, and whether what is there is what is asked for.

``stage.json`` is written last. It holds the resolved settings, the contents of the recipe, the digests of the
inputs and of the code, the version, and the seconds that the stage took, its share of them where several stages ran
side by side; a stage whose file says the same, whatever its seconds, is not run again, so an interrupted demo continues
where it stopped. No path is part of it: a folder that was moved or copied is still finished.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from motorprior import __version__
from motorprior.artifacts import read_json, remove_half_written, write_json
from motorprior.bench.fleet import fleet_path
from motorprior.exceptions import ArtifactError
from motorprior.pipeline.digests import code_digest, digest
from motorprior.pipeline.folder_lock import taken
from motorprior.pipeline.stopwatch import SHARED_TIME, UNFINISHED, Stopwatch, is_duration, seconds_of_same
from motorprior.results import Results
from motorprior.robots.robot import Robot

RESULTS, FIGURES = "results.json", "figures.json"
MARKER = "stage.json"


def description(
    name: str, file: str, settings: Mapping[str, Any], inputs: Sequence[Path], recipe: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a stage was asked to do, as JSON.

    Args:
        name: of the stage.
        file: of the module that does its work, its ``__file__``; that code counts, see `code_digest`.
        settings: resolved options; paths among them are left out, `inputs` speaks for them.
        inputs: every file that the stage reads, in a fixed order; counts by name and content.
        recipe: contents of the preset that an option names.
    """
    return {
        "stage": name,
        "version": __version__,
        "code": code_digest(file),
        "config": _plain(settings),
        "recipe": _plain(recipe or {}),
        "inputs": [f"{path.name} {digest(path)}" for path in inputs],
    }


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
    return seconds_of_same(folder / MARKER, wanted) is not None


def seconds_of(folder: Path) -> float:
    """Seconds of the finished stage in ``folder``, see `Stopwatch`.

    Raises:
        ArtifactError: no finished stage, or a damaged marker.
    """
    marker = read_json(folder / MARKER)
    seconds = marker.get("seconds") if isinstance(marker, dict) else None
    if seconds is None or not is_duration(seconds):
        raise ArtifactError("it does not say how long the stage took", where=folder / MARKER, remedy="run it again")
    return seconds


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
        SHARED_TIME.change(1)
        try:
            yield clock
            seconds = clock.seconds()
        except KeyboardInterrupt:
            clock.note()
            raise
        finally:
            SHARED_TIME.change(-1)
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
