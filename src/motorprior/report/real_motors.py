"""Sections on models of the motors in real logs, evaluated on held-out logs."""

from __future__ import annotations

from pathlib import Path

from motorprior.identification.evaluation.log_tables import (
    WHOLE_RUN_RMSE,
    constant_table,
    constants_in,
    error_table,
    errors_by_joint,
)
from motorprior.identification.evaluation.traces import read_traces
from motorprior.report import plots_real_motors
from motorprior.report.page import Section, Table, picture
from motorprior.results import Results

_LEAD = "Models of the motors simulate the joints from recorded commands, without feedback from the log."


def real_motors(run: Path) -> list[Section]:
    """From the files of the stage ``real_motors`` of a run."""
    return [_section(run / "real_motors", "Your motors", WHOLE_RUN_RMSE)]


def validated_log(folder: Path) -> Section:
    """From the files of `motorprior validate-log`."""
    return _section(folder, "Held-out log", "whole_run_rmse")


def _section(folder: Path, title: str, quantity: str) -> Section:
    results, (traces, lines) = Results.load(folder / "results.json"), read_traces(folder)
    tables = [_table(error_table(results, {quantity: "whole log"}), "Joint RMSE [mrad], over joints.")]
    if constants := constants_in(results):
        tables.append(_table(constant_table(constants), "Constants of your motors, over joints."))
    for row in results.where(quantity="whole_run_coverage90"):
        lines.append(f"{row.model}: {100 * row.value:.0f} % of the recorded angles are inside the 90 % bands.")
    pictures = (
        picture(plots_real_motors.errors_by_joint(errors_by_joint(results, quantity)), "Errors by joint."),
        picture(plots_real_motors.traces(traces), "The joints with the median and maximum error."),
    )
    return Section(title, (_LEAD, *lines), pictures, tuple(tables))


def _table(columns_and_rows: tuple[list[str], list[list[str]]], caption: str) -> Table:
    columns, rows = columns_and_rows
    return Table(tuple(columns), tuple(map(tuple, rows)), caption)
