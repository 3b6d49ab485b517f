"""The command validate-log: errors on the held-out log are printed."""

from motorprior.cli.terminal import print_table
from motorprior.commands.validate_log import ValidateLog, run_validate_log
from motorprior.evaluation.free_runs import error_table
from motorprior.priors.validate import ADAPTED, COVERAGE, SPANS, TRAINED_ON
from motorprior.progress import Progress


def run(config: ValidateLog, progress: Progress) -> None:
    """Validate and print errors and shares inside the bands."""
    results = run_validate_log(config, progress)
    is_trained = results.value(quantity=TRAINED_ON) > 0.0
    warning = " (warning: not a test, the prior was trained on this log)" if is_trained else ""
    title = f"Free runs, joint RMSE [mrad], over joints{warning}"
    print_table(title, *error_table(results, SPANS))

    rows = []
    for model in (ADAPTED, "prior"):
        for coverage, span in zip(COVERAGE.values(), SPANS.values(), strict=True):
            shares = [
                results.value(quantity=f"{coverage}{level}", model=model) for level in (50, 90)
            ]
            rows.append([model, span, *(f"{100 * share:.0f}" for share in shares)])
    columns = ["model", "free runs", "50 % band", "90 % band"]
    print_table(f"Recorded angles inside the bands [%]{warning}", columns, rows)
