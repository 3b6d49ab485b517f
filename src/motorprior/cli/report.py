"""``motorprior report``: the page of trained policies."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL
from motorprior.commands.walk_report import build_walk_report
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class MakeReport:
    """Write a page of trained policies: learning curves, films, robustness."""

    run: tyro.conf.Positional[Path]
    """Folder that `motorprior walk` wrote, or a folder of such folders."""
    robot: str = DEFAULT_ROBOT
    """Robot of the policies: a shipped one by name, or a .toml file."""
    robustness: bool = True
    """Also measure how long policies stay upright with pushes, on slippery ground, with delay or load: about ten
    seconds per policy."""


def run_report(config: MakeReport) -> None:
    """Write the page and print its path."""
    words = ["motorprior", "report", str(config.run), "--robot", config.robot]
    command = shlex.join([*words, *([] if config.robustness else ["--no-robustness"])])
    print(build_walk_report(config.run, config.robot, command, config.robustness, TERMINAL))
