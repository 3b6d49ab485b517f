"""``motorprior report``: the page of a run folder, from whatever stages are finished."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from motorprior.artifacts import read_json
from motorprior.cli.stage import MARKER
from motorprior.exceptions import ArtifactError, ConfigError

PAGE, SETTINGS = "report.html", "demo.json"


@dataclass(frozen=True)
class MakeReport:
    """Write the report of a demo's run folder anew."""

    run: tyro.conf.Positional[Path]
    """Folder that `motorprior demo --out` wrote."""


def build_report(run: Path) -> Path:
    """Write report.html from the finished stages; returns its path.

    Raises:
        ConfigError: the folder is no demo's.
        ArtifactError: a file in it is damaged.
    """
    from motorprior.cli import sections  # here: they import matplotlib, a second that no other command needs
    from motorprior.transfer.report import Report, Section, write_report

    stages: dict[str, tuple[str, Callable[[Path], list[Section]]]] = {
        "bench": ("bench/rollout", sections.bench),
        "identify": ("priors/rollout", sections.identify),
        "validate": ("validate", sections.validate),
        "replay": ("replay", sections.replay),
        "walk": ("walk/rollout_0", sections.walk),
        "transfer": ("transfer", sections.transfer),
    }  # the folder whose marker says that it is finished, and what it adds to the page
    if not (run / SETTINGS).is_file():
        raise ConfigError(f"no {SETTINGS} in it", where=run, remedy="give the --out folder of `motorprior demo`")
    settings = _settings(run / SETTINGS)
    found: list[Section] = []
    pending: list[str] = []
    for name, (folder, make) in stages.items():
        if (run / folder / MARKER).is_file():
            found += make(run)
        elif name != "replay" or settings["logs"] is not None:
            pending.append(name)
    if settings["logs"] is None:
        found.insert(min(len(found), 3), sections.no_logs())
    done = not pending and (run / "figures.json").is_file()
    report = Report(
        title="motorprior",
        subtitle="Learn the distribution of a robot's motors from logs, train a policy on samples of it, and see "
        "whether it transfers.",
        sections=tuple(found),
        settings=settings,
        command=sections.command(settings),
        pending=tuple(pending),
        highlights=sections.highlights(read_json(run / "figures.json")) if done else (),
    )
    write_report(run / PAGE, report)
    return run / PAGE


def _settings(path: Path) -> dict[str, Any]:
    settings = read_json(path)
    if not isinstance(settings, dict) or not {"logs", "fleet", "seed"} <= settings.keys():
        raise ArtifactError("not the settings of a demo", where=path, remedy="run `motorprior demo` there again")
    return settings


def run_report(config: MakeReport) -> None:
    """Write the page and say where."""
    print(build_report(config.run))
