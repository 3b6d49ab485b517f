"""A stage of work in a folder: finished or not, and whether what is there is what is asked for.

``stage.json`` is written last. It holds the resolved settings, the contents of the recipe, the digests of the
inputs and of the code, and the version; a stage whose file says the same is not run again, so an interrupted
demo continues where it stopped. No path is part of it: a folder that was moved or copied is still finished.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any

from motorprior import __version__
from motorprior.artifacts import read_json, write_json
from motorprior.bench.fleet import fleet_path
from motorprior.exceptions import ArtifactError

MARKER = "stage.json"
_STAGES = ("bench", "identify", "validate", "replay", "walk", "transfer")
_NEEDS = {"identify": ("bench",), "validate": ("bench",)}
"""Stages whose own module another one's numbers depend on: which motors stood on a bench."""
_PRESENTATION = (
    *("report/*"),
    *(f"cli/{name}.py" for name in ("main", "console", "stage", "logs", "speed")),
    *("cli/demo*", "cli/report*", "cli/sections*", "cli/run_record*"),
    *("hardware/*", "cli/deploy*", "cli/record*", "cli/doctor*", "cli/virtual_pupper*"),
    *("cli/robot_choice*", "cli/twin_body*", "simulation/live_robot*", "simulation/hung_load*", "logs/robot_run*"),
)
"""Modules that change no number of any stage; those of the robot have no stages."""


def digest(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        ArtifactError: it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ArtifactError(f"cannot read ({error.strerror})", where=path, remedy="check the path") from error


def description(
    name: str, settings: Mapping[str, Any], inputs: Sequence[Path], recipe: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """What a stage was asked to do, as JSON.

    Args:
        name: of the stage; its module in `motorprior.cli` has the same.
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
    others = [f"cli/{name}.py" for name in _STAGES if name != stage and name not in _NEEDS.get(stage, ())]
    parts = []
    for path in sorted(package.rglob("*.py")):
        inner = path.relative_to(package)
        if not any(inner.match(pattern) for pattern in (*_PRESENTATION, *others)):
            parts.append(f"{inner.as_posix()} {digest(path)}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def fleet_files(fleet: str) -> list[Path]:
    """The file of a fleet, shipped or given by path.

    Raises:
        ArtifactError: there is none.
    """
    return [fleet_path(fleet)]


def read_figures(path: Path) -> dict[str, float]:
    """The figures of a finished stage.

    Raises:
        ArtifactError: missing, damaged, or with a value that is not a finite number.
    """
    remedy = f"delete the folder {path.parent} and run the same command again"
    try:
        figures = read_json(path)
    except ArtifactError as error:
        raise ArtifactError(error.problem, where=path, remedy=remedy) from error
    if not isinstance(figures, dict):
        raise ArtifactError("not a table of figures", where=path, remedy=remedy)
    for name, value in figures.items():
        if type(value) not in (int, float) or (type(value) is float and not isfinite(value)):
            raise ArtifactError(f"{name} = {str(value)[:40]} is not a finite number", where=path, remedy=remedy)
    return figures


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
            f"cannot write there ({error.strerror})", where=folder, remedy="choose another folder"
        ) from error


def finish(folder: Path, done: dict[str, Any]) -> None:
    """Mark the stage as finished."""
    write_json(folder / MARKER, done)
