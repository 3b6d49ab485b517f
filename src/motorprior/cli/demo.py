"""The command demo: errors on the user's logs, and the paths of the results, are printed."""

from motorprior.cli.terminal import command_line, print_table
from motorprior.commands.demo import Demo, run_demo
from motorprior.evaluation.errors import FREE_RUN_RMSE, WHOLE_RUN_RMSE
from motorprior.evaluation.free_runs import error_table
from motorprior.progress import Progress
from motorprior.stage import FIGURES, PAGE

_SPANS = {FREE_RUN_RMSE: "1 s", WHOLE_RUN_RMSE: "whole log"}


def run(config: Demo, progress: Progress) -> None:
    """Run the demo and print where its report is."""
    results = run_demo(config, progress, command_line())
    if config.logs is not None:
        measured_spans = {
            quantity: span for quantity, span in _SPANS.items() if results.where(quantity=quantity)
        }
        columns, rows = error_table(results, measured_spans)
        print_table("Your motors: free runs, joint RMSE [mrad], over joints", columns, rows)
    print(f"Report: {config.out / PAGE}   Figures: {config.out / FIGURES}")
