"""How the motors of real logs compare, on the terminal."""

from __future__ import annotations

from motorprior.cli.console import table
from motorprior.report.real_motor_tables import CONSTANT_COLUMNS, NAMES, constant_rows, error_rows, models_in
from motorprior.results import Results


def show_real_motors(results: Results, lines: list[str]) -> None:
    """Two tables and a few sentences, as `demo` has them from real logs."""
    columns = ["joint or log", *(NAMES[model] for model in models_in(results))]
    table("Your motors: RMSE of the angle [mrad], command in and motion out", columns, error_rows(results))
    if rows := constant_rows(results):
        table("Constants of your motors, and 90 % of the fleet's draws", list(CONSTANT_COLUMNS), rows)
    for line in lines:
        print(f"- {line}")
