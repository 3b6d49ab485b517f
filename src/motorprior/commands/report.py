"""Write a page of trained policies."""

from dataclasses import dataclass
from pathlib import Path

from motorprior.robots.shipped import DEFAULT_ROBOT


@dataclass(frozen=True)
class Report:
    """Write a page of trained policies."""

    run: Path
    """Folder that `motorprior walk` wrote, or a folder of such folders."""
    robot: str = DEFAULT_ROBOT
    """Robot of the policies: a shipped one by name, or a .toml file."""


def run_report(config: Report, command: str = "") -> Path:
    """Write the page, which names the ``command`` that makes it; returns its path."""
    from motorprior.report.sections import write_training_page  # here: it imports matplotlib

    return write_training_page(config.run, config.robot, command)
