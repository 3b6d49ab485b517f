"""The quick report of `motorprior demo --logs` on the terminal."""

from __future__ import annotations

from motorprior.cli.console import table
from motorprior.identification.evaluation.log_tables import (
    FREE_RUN,
    WHOLE_RUN,
    constant_table,
    constants_in,
    error_table,
)
from motorprior.results import Results


def show_real_motors(results: Results, lines: list[str]) -> None:
    """Errors of the models, constants of the motors, and the lines of the report."""
    spans = {FREE_RUN: "1 s", WHOLE_RUN: "whole log"}
    titles = {quantity: title for quantity, title in spans.items() if results.where(quantity=quantity)}
    table("Your motors: free runs, joint RMSE [mrad], over joints", *error_table(results, titles))
    if constants := constants_in(results):
        table("Constants of your motors", *constant_table(constants))
    for line in lines:
        print(f"- {line}")
