"""The page of a run folder, from whatever stages are finished."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from motorprior.artifacts import read_json
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.pipeline.stage import MARKER, RESULTS, digest, read_results
from motorprior.robots.load import load_robot
from motorprior.transfer.robustness import MAPS, load_maps

PAGE, SETTINGS, STAGES, CURVE = "report.html", "demo.json", "stages.json", "curve.json"
WALKER, REPLAYED = "robot_that_walks", "logs_replayed"
"""Settings that follow from the others: the robot of all but the first chapter, and whether it replays the logs."""
Made = TypeVar("Made")


def build_report(run: Path) -> Path:
    """Write report.html from the finished stages; returns its path.

    Raises:
        ConfigError: the folder is no demo's, or a file of a stage is damaged.
        ArtifactError: the settings in it are damaged.
    """
    from motorprior.report import sections  # here: they import matplotlib, a second that nothing else needs
    from motorprior.report.gait_sections import robustness_section
    from motorprior.report.learning import learning
    from motorprior.report.page import Report, Section, write_report
    from motorprior.report.real_motors import real_motors

    def walk(run: Path) -> list[Section]:
        folders: dict[str, list[Path]] = {}
        for folder in [run / folder for folder in belonging if _kind(folder) == "walk"]:  # called CONDITION_SEED
            folders.setdefault(folder.name.rsplit("_", 1)[0], []).append(folder)
        return learning(folders)

    def robustness(run: Path) -> list[Section]:
        folders = [folder for folder in belonging if _kind(folder) == "robustness"]
        maps = {Path(folder).name.removesuffix("_0"): load_maps(run / folder / MAPS) for folder in folders}
        return [robustness_section(maps)]

    if not (run / SETTINGS).is_file():
        raise ConfigError(f"no {SETTINGS} in it", where=run, remedy="give the folder that `motorprior demo` wrote")
    settings, command = _settings(run / SETTINGS)
    belonging = belonging_stages(run)
    first = [Path(folder).name for folder in belonging if _kind(folder) == "walk" and folder.endswith("_0")]
    stages: dict[str, tuple[tuple[str, ...], Callable[[Path], list[Section]]]] = {
        "real_motors": (("real_motors",), real_motors),
        "bench": (("bench/rollout", "bench/paper"), sections.bench),
        "identify": (("priors/rollout",), sections.identify),
        "validate": (("validate",), sections.validate),
        "replay": (("replay",), sections.replay),
        "walk": (("walk/rollout_0",), walk),
        "transfer": (("transfer",), lambda run: sections.transfer(run, load_robot(settings[WALKER]))),
        "robustness": (tuple(f"robustness/{name}" for name in first or ("rollout_0",)), robustness),
    }  # the folders that must belong to the settings, and what they add to the page
    ready = [name for name, (folders, _) in stages.items() if set(folders) <= set(belonging)]
    wanted = {"real_motors": settings["logs"] is not None, "replay": settings[REPLAYED]}
    pending = [name for name in stages if name not in ready and wanted.get(name, True)]
    highlights = _highlights(run) if not pending and (run / RESULTS).is_file() else ()
    found: list[Section] = []
    for name in ready:
        found += _chapters(run, *stages[name])
    if settings["logs"] is None:
        found.insert(min(len(found), 3), sections.no_logs())
    report = Report(
        title="motorprior",
        subtitle="Learn the distribution of a robot's motors from logs, train a policy on samples of it, and see "
        "whether it transfers.",
        sections=tuple(found),
        settings=settings,
        command=command,
        pending=tuple(pending),
        highlights=highlights,
    )
    write_report(run / PAGE, report)
    return run / PAGE


def _highlights(run: Path) -> tuple[tuple[str, str], ...]:
    from motorprior.report import sections

    return _from_files(lambda: sections.highlights(read_results(run)), run / RESULTS)


def _chapters(run: Path, folders: tuple[str, ...], make: Callable[[Path], Made]) -> Made:
    """What one stage adds to the page.

    Raises:
        ConfigError: one of its files is damaged.
    """
    root = run / _kind(folders[0])
    for path in sorted(root.glob(f"*/{CURVE}")):
        _from_files(partial(_check_curve, path), root)
    return _from_files(lambda: make(run), root)


def _from_files(make: Callable[[], Made], source: Path) -> Made:
    """The result of ``make``, which reads files of a finished stage; they were complete, unless someone damaged them.

    Raises:
        ConfigError: a file is damaged, or lacks what it had.
    """
    try:
        return make()
    except (ArtifactError, LogError) as error:
        problem, where, cause = error.problem, error.where or source, error
    except KeyError as error:
        problem, where, cause = f"it lacks {error}", source, error
    raise ConfigError(problem, where=where, remedy=f"delete {source} and run the same demo again") from cause


def _check_curve(path: Path) -> None:
    curve = read_json(path)
    whole = isinstance(curve, list) and all(
        isinstance(point, dict) and all(type(point.get(key)) in (int, float) for key in ("iteration", "mean_return"))
        for point in curve
    )
    if not whole:
        raise ArtifactError("not a learning curve", where=path)


def _settings(path: Path) -> tuple[dict[str, Any], str]:
    """Settings of a demo, and the command that was given."""
    found = read_json(path)
    settings, command = (found.get(name) if isinstance(found, dict) else None for name in ("settings", "command"))
    if (
        not isinstance(settings, dict)
        or not {"logs", WALKER, REPLAYED} <= settings.keys()
        or not isinstance(command, str)
    ):
        raise ArtifactError("not the settings of a demo", where=path, remedy="run `motorprior demo` there again")
    return settings, command


def belonging_stages(run: Path) -> list[str]:
    """Folders in ``run`` that hold what its present settings ask for, sorted."""
    try:
        listed = read_json(run / STAGES)
    except ArtifactError:  # no list, or one that cannot be read: nothing is known to belong
        return []
    if not isinstance(listed, dict):
        return []
    markers = {folder: run / folder / MARKER for folder in sorted(listed)}
    return [folder for folder, path in markers.items() if path.is_file() and digest(path) == listed[folder]]


def _kind(folder: str) -> str:
    """Of the stage in a folder: its first part."""
    return Path(folder).parts[0]
