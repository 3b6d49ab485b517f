"""What a training finds of other settings in its folder, and throws away: told before it is gone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from motorprior.artifacts import dotted, read_json, read_tensors
from motorprior.exceptions import ArtifactError, listed
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.stage import MARKER
from motorprior.pipeline.walking.training import CHECKPOINT

_MOST = 4
"""Differences that are told one by one."""


def tell_what_is_lost(folder: Path, wanted: Mapping[str, Any], progress: Progress) -> None:
    """Note the finished policy, and the checkpoint, of other settings that a training takes the place of.

    Args:
        folder: of the training.
        wanted: its `stage.description`.
        progress: where to report to.
    """
    finished = _marker(folder)
    if finished is not None:
        differs = _differences(finished, wanted)
        progress.note(f"{folder}: the policy that was finished there has other settings ({differs}); it is replaced")
    iterations, interrupted = _checkpoint(folder)
    if interrupted is not None and interrupted != wanted:
        differs = _differences(interrupted, wanted)
        progress.note(
            f"{folder}: the training that was interrupted there has other settings ({differs}); its {iterations} "
            "iterations are thrown away"
        )


def _marker(folder: Path) -> dict[str, Any] | None:
    """The description of the finished training in a folder; None of another stage, or none."""
    try:
        found = read_json(folder / MARKER)
    except ArtifactError:
        return None
    is_training = isinstance(found, dict) and found.get("stage") == "walk" and isinstance(found.get("config"), dict)
    return {name: value for name, value in found.items() if name != "seconds"} if is_training else None


def _checkpoint(folder: Path) -> tuple[int, dict[str, Any] | None]:
    """Iterations and description of the interrupted training in a folder; a damaged one is refused where it is read."""
    try:
        state, header = read_tensors(folder / CHECKPOINT)
        wanted = header["wanted"]
        return int(state["iteration"]), wanted if isinstance(wanted, dict) else None
    except (ArtifactError, KeyError):
        return 0, None


def _differences(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """In words, settings first."""
    old, new = dotted(found.get("config", {})), dotted(wanted["config"])
    names = [name for name in dict.fromkeys((*new, *old)) if old.get(name) != new.get(name)]
    told = [f"{name} was {old.get(name)}, is {new.get(name)}" for name in names]
    if found.get("inputs") != wanted["inputs"]:
        told.append("other files as inputs")
    if any(found.get(name) != wanted[name] for name in ("version", "code")):
        told.append("another version of the program")
    return listed(told, _MOST)
