"""``motorprior validate``: closed-loop fidelity of motor priors, compared with their physical motors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.commands.validate import Validate, run_validate
from motorprior.report.tables import fidelity_rows
from motorprior.results import Results
from motorprior.studies.metrics import FIDELITY_METRICS

_DISTRIBUTION = (
    "adapt_rmse_ratio", "adapt_false_alarms", "adapt_unlikely", "coverage50", "coverage90", "two_sample_auc",
    "energy_distance",
)  # fmt: skip


@dataclass(frozen=True)
class ValidateCommand(Validate):
    """Measure how far simulated motors are from the physical ones, in closed loop, on held-out excitation."""

    priors: tyro.conf.Positional[tuple[Path, ...]]


def validate(config: ValidateCommand) -> None:
    """See `run_validate`."""
    show_fidelity(run_validate(config, TERMINAL))


def show_fidelity(results: Results) -> None:
    """Medians on the terminal; held-out motors and the distribution, where measured."""
    title = "Closed-loop joint RMSE [rad] and torque above 20 Hz (hf) [N·m], medians; physical is the floor"
    _show_table(title, results, "train")
    if not results.where(motors="held_out"):
        return
    _show_table("The same on held-out motors, adapted to 10 s of log each", results, "held_out")
    figures = results.where(quantity=_DISTRIBUTION).to_figures()
    if figures:
        rows = [[name, f"{value:.3f}"] for name, value in figures.items()]
        table("Preset rollout on held-out motors", ["figure", "value"], rows)


def _show_table(title: str, results: Results, motors: str) -> None:
    columns = tuple(column for column in FIDELITY_METRICS if results.where(quantity=column, motors=motors))
    titles = [column.replace("_rmse", "").replace("_torque_hf", " hf").replace("_", " ") for column in columns]
    table(title, ["model", *titles], fidelity_rows(results, columns, motors))
