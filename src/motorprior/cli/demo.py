"""The command demo: errors on the user's logs, and the paths of the results, are printed."""

from motorprior.cli.terminal import command_line, print_table
from motorprior.commands.demo import Demo, run_demo
from motorprior.evaluation.free_runs import SPAN_TITLES, error_table
from motorprior.priors.quick_report import QUANTITIES
from motorprior.progress import Progress
from motorprior.stage import FIGURES, PAGE


def run(config: Demo, progress: Progress) -> None:
    """Run the demo and print where its report is."""
    results = run_demo(config, progress, command_line())
    if config.logs is not None:
        titles = {}
        for span, quantity in QUANTITIES.items():
            if results.where(quantity=quantity):  # reports without loads have whole runs only
                titles[quantity] = SPAN_TITLES[span]
        columns, rows = error_table(results, titles)
        print_table("Your motors: free runs, joint RMSE [mrad], over joints", columns, rows)
    print(f"Report: {config.out / PAGE}   Figures: {config.out / FIGURES}")
