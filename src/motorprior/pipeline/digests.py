"""Digests of files and of the code that a stage's results can depend on."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from motorprior.exceptions import ArtifactError
from motorprior.pipeline.module_imports import sources

_LEFT_OUT = {
    "motorprior.report": "pages and pictures",
    "motorprior.transfer.study_verdicts": "judges what is finished",
    "motorprior.pipeline.transfer_study.study_report": "a page",
    "motorprior.pipeline.walking.earlier_training": "tells what a new training throws away",
    "motorprior.pipeline.walking.walk_metrics": "tells how a training goes",
    "motorprior.pipeline.walking.tensorboard": "tells how a training goes",
    "motorprior.pipeline.progress": "tells how far a stage is",
    "motorprior.pipeline.side_by_side": "results do not depend on it",
    "motorprior.pipeline.stage": "knows what is finished",
    "motorprior.pipeline.digests": "knows what is finished",
    "motorprior.pipeline.stopwatch": "knows how long it took",
    "motorprior.pipeline.folder_lock": "knows who writes",
}
"""What stages import and no number of theirs depends on, and why; what only these import is left out with them."""


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


@cache
def code_digest(file: str) -> str:
    """SHA-256 of the code of a stage, shortened.

    It covers the module of the stage and whatever this imports, at once or later and at any remove, less `_LEFT_OUT`.
    Other code can be edited and the stage is still finished. Column maps and tables of formats
    (``logs/formats/**/*.toml``) count with the modules that read them; robots, fleets and files of users are inputs of
    the stages that read them.

    Args:
        file: of the module; a script's sources beside it count too.
    """
    return package_digest(Path(file).resolve(), Path(__file__).resolve().parents[1])


def package_digest(file: Path, package: Path) -> str:
    """`code_digest` of the package in some folder, which has the package's name."""
    parts = [f"{name} {hashlib.sha256(text).hexdigest()}" for name, text in sources(file, package, _LEFT_OUT).items()]
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()[:16]
