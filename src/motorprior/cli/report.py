"""``motorprior report``: the page of a run folder, from whatever stages are finished."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import tyro

from motorprior.artifacts import read_json
from motorprior.cli.run_record import belongs
from motorprior.cli.stage import read_figures
from motorprior.exceptions import ArtifactError, ConfigError, LogError

PAGE, SETTINGS, FIGURES, CURVE = "report.html", "demo.json", "figures.json", "curve.json"
Made = TypeVar("Made")


@dataclass(frozen=True)
class MakeReport:
    """Write the report of a demo's run folder anew."""

    run: tyro.conf.Positional[Path]
    """Folder that `motorprior demo --out` wrote."""


def build_report(run: Path) -> Path:
    """Write report.html from the finished stages; returns its path.

    Raises:
        ConfigError: the folder is no demo's, or a file of a stage is damaged.
        ArtifactError: the settings in it are damaged.
    """
    from motorprior.cli import sections  # here: they import matplotlib, a second that no other command needs
    from motorprior.cli.demo_command import demo_command  # here: it needs the demo, which needs this module
    from motorprior.report.page import Report, Section, write_report

    stages: dict[str, tuple[tuple[str, ...], Callable[[Path], list[Section]]]] = {
        "bench": (("bench/rollout", "bench/paper"), sections.bench),
        "identify": (("priors/rollout",), sections.identify),
        "validate": (("validate",), sections.validate),
        "replay": (("replay",), sections.replay),
        "walk": (("walk/rollout_0",), sections.walk),
        "transfer": (("transfer",), sections.transfer),
    }  # the folders that must belong to the settings, and what they add to the page
    if not (run / SETTINGS).is_file():
        raise ConfigError(f"no {SETTINGS} in it", where=run, remedy="give the --out folder of `motorprior demo`")
    settings = _settings(run / SETTINGS)
    ready = [name for name, (folders, _) in stages.items() if all(belongs(run, folder) for folder in folders)]
    pending = [name for name in stages if name not in ready and (name != "replay" or settings["logs"] is not None)]
    highlights = _highlights(run) if not pending and (run / FIGURES).is_file() else ()
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
        command=demo_command(settings),
        pending=tuple(pending),
        highlights=highlights,
    )
    write_report(run / PAGE, report)
    return run / PAGE


def _highlights(run: Path) -> tuple[tuple[str, str], ...]:
    from motorprior.cli import sections

    return _from_files(lambda: sections.highlights(read_figures(run / FIGURES)), run / FIGURES)


def _chapters(run: Path, folders: tuple[str, ...], make: Callable[[Path], Made]) -> Made:
    """What one stage adds to the page.

    Raises:
        ConfigError: one of its files is damaged.
    """
    root = run / folders[0].split("/")[0]
    for path in (root / FIGURES, *sorted(root.glob(f"*/{CURVE}"))):
        if path.is_file():
            _from_files(partial(read_figures if path.name == FIGURES else _check_curve, path), root)
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


def _settings(path: Path) -> dict[str, Any]:
    settings = read_json(path)
    if not isinstance(settings, dict) or not {"logs", "fleet", "seed"} <= settings.keys():
        raise ArtifactError("not the settings of a demo", where=path, remedy="run `motorprior demo` there again")
    return settings


def run_report(config: MakeReport) -> None:
    """Write the page and say where."""
    print(build_report(config.run))
