"""The command identify: the prior is printed."""

from motorprior.commands.identify import Identify, run_identify
from motorprior.progress import Progress


def run(config: Identify, progress: Progress) -> None:
    """Fit the prior and print it."""
    print(run_identify(config, progress))
