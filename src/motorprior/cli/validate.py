"""The command validate: errors on the held-out log are printed."""

from motorprior.cli.terminal import command_line, print_table
from motorprior.commands.validate import Validate, run_validate
from motorprior.evaluation.bands import LEVELS
from motorprior.evaluation.errors import PRIOR
from motorprior.evaluation.free_runs import SPAN_TITLES, error_table
from motorprior.priors.validate import ADAPTED, QUANTITIES, TRAINED_ON, coverage_quantity
from motorprior.progress import Progress


def run(config: Validate, progress: Progress) -> None:
    """Validate and print errors and shares inside the bands."""
    results = run_validate(config, progress, command_line())
    is_trained = results.value(quantity=TRAINED_ON) > 0.0
    warning = " (warning: not a test, the prior was trained on this log)" if is_trained else ""
    title = f"Free runs, joint RMSE [mrad], over joints{warning}"
    titles = {quantity: SPAN_TITLES[span] for span, quantity in QUANTITIES.items()}
    print_table(title, *error_table(results, titles))

    rows = []
    for model in (ADAPTED, PRIOR):
        for span, span_title in SPAN_TITLES.items():
            row = [model, span_title]
            for level in LEVELS:
                share = results.value(quantity=coverage_quantity(span, level), model=model)
                row.append(f"{100 * share:.0f}")
            rows.append(row)
    columns = ["model", "free runs", *(f"{level} % band" for level in LEVELS)]
    print_table(f"Recorded angles inside the bands [%]{warning}", columns, rows)
