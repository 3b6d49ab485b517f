"""The first section of a report with real logs: real motors compared with models of them."""

from __future__ import annotations

from pathlib import Path

from motorprior.artifacts import read_tensors
from motorprior.report.page import Section, Table, picture
from motorprior.report.plots_real_motors import errors_by_joint, traces
from motorprior.report.real_motor_tables import NAMES, RMSE, constant_table, error_rows, from_tensors, models_in
from motorprior.results import Results


def real_motors(run: Path) -> list[Section]:
    """From the files of the stage ``real_motors`` of a run."""
    results = Results.load(run / "real_motors" / "results.json")
    tensors, header = read_tensors(run / "real_motors" / "traces.safetensors")
    models, joints = models_in(results), results.where(quantity=RMSE, log=None)
    errors = {
        model: {row.part: row.value for row in joints.where(model=model) if row.part is not None} for model in models
    }
    pictures = (
        picture(errors_by_joint(errors), "Error of every model at every joint."),
        picture(
            traces(from_tensors(tensors, header)),
            "Recorded and simulated angles: a joint with the usual error, and the one with the largest.",
        ),
    )
    caption = "RMSE of the angle [mrad], no offset removed. A PD has the same gains at all joints."
    tables = [Table(("joint or log", *(NAMES[model] for model in models)), error_rows(results), caption)]
    if (constants := constant_table(results)).rows:
        tables.append(Table(constants.columns, constants.rows, f"{constants.caption}."))
    lead = "Models of the motors are given the recorded commands; their angles are compared with the recorded ones."
    return [Section("Your motors", (lead, *header["lines"]), pictures, tuple(tables))]
