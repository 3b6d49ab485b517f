"""The first section of a demo's page: models of the motors in real logs, evaluated on held-out logs."""

from __future__ import annotations

from pathlib import Path

from motorprior.artifacts import read_tensors
from motorprior.identification.evaluation.log_tables import (
    WHOLE_RUN,
    constant_table,
    constants_in,
    error_table,
    errors_by_joint,
    from_tensors,
)
from motorprior.report import plots_real_motors
from motorprior.report.page import Section, Table, picture
from motorprior.results import Results


def real_motors(run: Path) -> list[Section]:
    """From the files of the stage ``real_motors`` of a run."""
    results = Results.load(run / "real_motors" / "results.json")
    tensors, header = read_tensors(run / "real_motors" / "traces.safetensors")
    lead = "Models of your motors simulate the joints from recorded commands, without feedback from the log."
    tables = [_table(error_table(results, {WHOLE_RUN: "whole log"}), "Joint RMSE [mrad], over joints.")]
    if constants := constants_in(results):
        tables.append(_table(constant_table(constants), "Constants of your motors, over joints."))
    errors = plots_real_motors.errors_by_joint(errors_by_joint(results, WHOLE_RUN))
    traces = plots_real_motors.traces(from_tensors(tensors, header))
    pictures = (
        picture(errors, "Errors of the models by joint."),
        picture(traces, "The joints with the median and maximum error."),
    )
    return [Section("Your motors", (lead, *header["lines"]), pictures, tuple(tables))]


def _table(columns_and_rows: tuple[list[str], list[list[str]]], caption: str) -> Table:
    columns, rows = columns_and_rows
    return Table(tuple(columns), tuple(map(tuple, rows)), caption)
