"""The command adapt: the posterior is printed."""

from motorprior.commands.adapt import Adapt, run_adapt
from motorprior.progress import Progress


def run(config: Adapt, progress: Progress) -> None:
    """Adapt the prior and print the posterior."""
    print(run_adapt(config, progress))
