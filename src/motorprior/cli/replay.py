"""The command replay: errors of the replayed logs are printed."""

from motorprior.cli.terminal import print_table
from motorprior.commands.replay import Replay, run_replay
from motorprior.progress import Progress
from motorprior.report.tables import replay_table


def run(config: Replay, progress: Progress) -> None:
    """Replay the logs and print the errors."""
    results = run_replay(config, progress)
    print_table("Real logs: joint RMSE [mrad], start included", *replay_table(results))
