"""The first chapter of a report: real motors beside a PD, a prior and each other."""

from __future__ import annotations

from pathlib import Path

from motorprior.artifacts import read_tensors
from motorprior.report.page import Picture, Section, Table, picture
from motorprior.report.plots_real_motors import constants_beside_fleet, errors_by_joint, traces
from motorprior.report.real_motor_tables import (
    CONSTANT,
    NAMES,
    RMSE,
    constant_table,
    error_rows,
    from_tensors,
    models_in,
)
from motorprior.results import Results


def real_motors(run: Path) -> list[Section]:
    """From the files of the stage ``real_motors`` of a run."""
    results = Results.load(run / "real_motors" / "results.json")
    tensors, header = read_tensors(run / "real_motors" / "traces.safetensors")
    lead = "Your logs first: the recorded commands go into models of the motors, what comes out is compared."
    columns = ("joint or log", *(NAMES[model] for model in models_in(results)))
    tables = [
        Table(
            columns,
            tuple(map(tuple, error_rows(results))),
            "RMSE of the angle [mrad], no mean removed. A PD has the same gains at all joints.",
        )
    ]
    pictures = [_errors(results), _traces(tensors, header)]
    if (constants := constant_table(results)).rows:
        tables.append(Table(constants.columns, constants.rows, f"{constants.caption}."))
    if shown := _constants(results):
        pictures.append(shown)
    return [Section("Your motors", (lead, *header["lines"]), tuple(pictures), tuple(tables))]


def _errors(results: Results) -> Picture:
    rows = results.where(quantity=RMSE, log=None)
    errors = {
        model: {row.part: row.value for row in rows.where(model=model) if row.part is not None}
        for model in models_in(results)
    }
    return picture(errors_by_joint(errors), "How far models are from every joint.")


def _traces(tensors: dict, header: dict) -> Picture:
    caption = "What joints did and what models of them do: one with the usual error, and the one farthest off."
    return picture(traces(from_tensors(tensors, header)), caption)


def _constants(results: Results) -> Picture | None:
    """None where there is no fleet to compare with."""
    motors: dict[str, list[float]] = {}
    fleet: dict[str, tuple[float, float, float]] = {}
    name = ""
    for quantity in results.distinct("quantity"):
        of, constant = results.where(quantity=quantity), quantity.removeprefix(CONSTANT)
        if of.where(statistic="p50"):
            low, middle, high = (of.value(statistic=statistic) for statistic in ("p05", "p50", "p95"))
            fleet[constant], name = (low, middle, high), of.where(statistic="p50").rows[0].model or ""
            motors[constant] = [row.value for row in of if row.part is not None]
    if not fleet:
        return None
    figure = constants_beside_fleet(motors, fleet, name)
    return picture(figure, f"Your motors beside the fleet {name}.")
