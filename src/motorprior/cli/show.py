"""The command show: the content of a file is printed."""

from motorprior.commands.show import Show, content
from motorprior.progress import Progress


def run(config: Show, progress: Progress) -> None:
    """Print the content of the file."""
    print(content(config))
