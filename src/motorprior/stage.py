"""A stage of work in a folder: settings + digests of the inputs + version -> folder.

``stage.json`` is written last. A stage whose file holds the same description is not run again, so
an interrupted command continues where it stopped. The description excludes paths: a folder that was
moved or copied is still finished.
"""

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from motorprior import __version__
from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError

RESULTS = "results.json"
FIGURES = "figures.json"
PAGE = "report.html"
MARKER = "stage.json"
LOCK = ".lock"


def digest(path: Path) -> str:
    """SHA-256 of a file; raises ArtifactError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        problem = f"cannot read ({error.strerror})"
        raise ArtifactError(problem, where=path, remedy="check the path") from error


def description(
    name: str,
    settings: Mapping[str, Any],
    inputs: Sequence[Path],
    recipe: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Description of a stage as JSON: version, settings, and names and digests of its inputs.

    Args:
        name: of the stage.
        settings: resolved options; paths are left out, since ``inputs`` represent them.
        inputs: all files that the stage reads, in a fixed order.
        recipe: content of the preset that an option names.
    """
    return {
        "stage": name,
        "version": __version__,
        "config": _plain(settings),
        "recipe": _plain(recipe or {}),
        "inputs": [f"{path.name} {digest(path)}" for path in inputs],
    }


def _plain(value: Any) -> Any:
    """JSON values without paths and fleet files, whose digests are among the inputs."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items() if not _is_path(item)}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value if not _is_path(item)]
    return value


def _is_path(value: Any) -> bool:
    return isinstance(value, Path) or (isinstance(value, str) and value.endswith(".toml"))


def is_finished(folder: Path, stage: dict[str, Any]) -> bool:
    """Whether ``folder`` has the result of the stage with this `description`."""
    try:
        marker = read_json(folder / MARKER)
    except ArtifactError:
        return False
    return isinstance(marker, dict) and marker == stage | {"seconds": marker.get("seconds")}


@contextmanager
def working(folder: Path, stage: dict[str, Any]) -> Iterator[None]:
    """Run the stage with this `description` in its `locked` folder.

    The stage is finished at the end of the context, unless an error was raised.
    """
    with locked(folder):
        (folder / MARKER).unlink(missing_ok=True)
        started = time.monotonic()
        yield
        write_json(folder / MARKER, stage | {"seconds": time.monotonic() - started})


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create and lock a folder; the same thread may lock it again.

    A new folder that stays empty is removed. Raises ArtifactError if another process or thread
    writes there, or the folder cannot be created.
    """
    is_new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(folder.resolve() / LOCK, timeout=0, is_singleton=True)
        lock.acquire()
    except Timeout as error:
        remedy = "wait until it ends, or choose another folder"
        raise ArtifactError("another command writes there", where=folder, remedy=remedy) from error
    except OSError as error:
        problem = f"cannot write there ({error.strerror or error})"
        raise ArtifactError(problem, where=folder, remedy="choose another folder") from error

    try:
        yield
    finally:
        lock.release()
        is_unused = is_new and not lock.is_locked
        if is_unused and {path.name for path in folder.iterdir()} <= {LOCK}:
            (folder / LOCK).unlink(missing_ok=True)
            folder.rmdir()
