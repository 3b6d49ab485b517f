"""How the motors of real logs compare, on the terminal."""

from __future__ import annotations

from motorprior.cli.console import table
from motorprior.report.real_motor_tables import NAMES, constant_table, error_rows, models_in
from motorprior.results import Results


def show_real_motors(results: Results, lines: list[str]) -> None:
    """Two tables and a few sentences, as `demo` has them from real logs."""
    columns = ["joint or log", *(NAMES[model] for model in models_in(results))]
    table("Your motors: RMSE of the angle [mrad], command in and motion out", columns, error_rows(results))
    if (constants := constant_table(results)).rows:
        table(constants.caption, list(constants.columns), list(map(list, constants.rows)))
    for line in lines:
        print(f"- {line}")
