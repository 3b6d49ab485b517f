"""The command report: the path of the page is printed."""

from dataclasses import dataclass
from pathlib import Path

from motorprior.cli.terminal import command_line
from motorprior.progress import Progress
from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Report:
    """Write a page of trained policies."""

    run: Path
    """Folder that `motorprior walk` wrote, or a folder of such folders."""
    robot: str = DEFAULT_ROBOT
    """Robot of the policies: a shipped one by name, or a .toml file."""


def run(config: Report, progress: Progress) -> None:
    """Write the page and print its path."""
    from motorprior.report.sections import write_training_page  # here: it imports matplotlib

    print(write_training_page(config.run, config.robot, command_line()))
