"""Digests of files and of the code that a stage's results can depend on."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from motorprior.exceptions import ArtifactError

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
    "robustness",
    "study",
)
_NEEDS = {
    "validate": ("adapt",),
    "real_motors": ("adapt", "identify"),
    "robustness": ("transfer",),
    "study": ("transfer",),
}
"""Stages whose own module another one's numbers depend on."""
_PARTS = {"identify": ("training_log",), "study": ("study_watch",), "walk": ("training", "trained_policy", "contests")}
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
            "digests",
            "stopwatch",
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
        for name in ("statistics", "study_summary", "study_verdicts", "study_targets", "study_claims", "study_results")
    ),  # judges
    *(
        f"pipeline/{name}.py"
        for name in (
            *("play", "walk_film", "schedule_file", "walk_report", "walk_metrics", "walk_seeds", "earlier_training"),
        )
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
