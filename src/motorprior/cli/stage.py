"""A stage of work in a folder: finished or not, and whether what is there is what is asked for.

``stage.json`` is written last. It holds the resolved settings, the digests of the inputs and the version;
a stage whose file says the same is not run again, so an interrupted demo continues where it stopped.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from motorprior import __version__
from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError

MARKER = "stage.json"


def digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        ArtifactError: it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ArtifactError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def description(name: str, settings: Mapping[str, Any], inputs: Sequence[Path]) -> dict[str, Any]:
    """What a stage was asked to do, as JSON."""
    return {
        "stage": name,
        "version": __version__,
        "config": _plain(settings),
        "inputs": {str(path): digest(path) for path in inputs},
    }


def fleet_files(fleet: str) -> list[Path]:
    """The file of a fleet that was given by path; a shipped one changes with the version only."""
    return [Path(fleet)] if fleet.endswith(".toml") else []


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def is_finished(folder: Path, wanted: dict[str, Any]) -> bool:
    """Whether ``folder`` holds the result of exactly this stage."""
    try:
        return read_json(folder / MARKER) == wanted
    except ArtifactError:  # none there, or none that can be read: the stage runs again
        return False


def begin(folder: Path) -> None:
    """Take the folder: from here until `finish` it counts as unfinished.

    Raises:
        ArtifactError: it cannot be created or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MARKER).unlink(missing_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ArtifactError(
            f"cannot write there ({error.strerror})", where=folder, remedy="choose another --out folder"
        ) from error


def finish(folder: Path, done: dict[str, Any]) -> None:
    """Mark the stage as finished."""
    write_json(folder / MARKER, done)
