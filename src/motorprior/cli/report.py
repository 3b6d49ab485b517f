"""``motorprior report``: the page of a run folder, from its finished stages."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL
from motorprior.pipeline.report import SETTINGS, build_report
from motorprior.pipeline.watching.walk_report import build_walk_report
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class MakeReport:
    """Write the page of a demo's run folder again, or a page of trained policies."""

    run: tyro.conf.Positional[Path]
    """Folder that `motorprior demo` wrote, or that `motorprior walk` wrote policies into."""
    robot: str = DEFAULT_ROBOT
    """Robot of trained policies: a shipped one by name, or a .toml file; not for the folder of a demo."""
    robustness: bool = True
    """Also measure how long policies stay upright with pushes, on slippery ground, with delay or load: some ten seconds
    each."""


def run_report(config: MakeReport) -> None:
    """Write the page and print its path."""
    words = ["motorprior", "report", str(config.run), "--robot", config.robot]
    command = shlex.join([*words, *([] if config.robustness else ["--no-robustness"])])
    if (config.run / SETTINGS).is_file():
        print(build_report(config.run))
    else:
        print(build_walk_report(config.run, config.robot, command, config.robustness, TERMINAL))
