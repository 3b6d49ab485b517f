"""The command play: measures of the walks and the path of the film are printed."""

from motorprior.cli.terminal import print_table
from motorprior.commands.play import Play, run_play
from motorprior.progress import Progress
from motorprior.report.tables import gait_table


def run(config: Play, progress: Progress) -> None:
    """Render the walks and print their measures."""
    film, results = run_play(config, progress)
    print_table("From the first second on (docs/play.md)", *gait_table(results))
    print(film)
