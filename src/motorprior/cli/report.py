"""The command report: the path of the page is printed."""

from motorprior.cli.terminal import command_line
from motorprior.commands.report import Report, run_report
from motorprior.progress import Progress


def run(config: Report, progress: Progress) -> None:
    """Write the page and print its path."""
    print(run_report(config, command_line()))
