"""``motorprior validate``: closed-loop fidelity of motor priors against the physical motors they learned from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.validate import Validate, run_validate
from motorprior.report.tables import fidelity_rows
from motorprior.transfer.metrics import COLUMNS

_DISTRIBUTION = (
    "adapt_rmse_ratio", "adapt_false_alarms", "adapt_unlikely", "coverage50", "coverage90", "two_sample",
    "energy_distance",
)  # fmt: skip


@dataclass(frozen=True)
class ValidateCommand(Validate):
    """Measure how far simulated motors are from the physical ones, in closed loop, on held-out excitation."""

    priors: tyro.conf.Positional[tuple[Path, ...]]


def validate(config: ValidateCommand) -> None:
    """See `run_validate`."""
    show_fidelity(run_validate(config, TERMINAL))


def show_fidelity(figures: dict[str, float]) -> None:
    """Medians on the terminal; held-out motors and the distribution, where measured."""
    title = "Closed-loop joint RMSE [rad] and torque above 20 Hz (hf) [N·m], medians; physical is the floor"
    _show_table(title, figures, "")
    if "two_sample_auc" not in figures:
        return
    _show_table("The same on held-out motors, known from 10 s of log each", figures, "/held_out")
    rows = [[name, f"{value:.3f}"] for name, value in figures.items() if name.startswith(_DISTRIBUTION)]
    table("Preset rollout on motors nobody trained on", ["figure", "value"], rows)


def _show_table(title: str, figures: dict[str, float], ending: str) -> None:
    titles = [column.replace("_rmse", "").replace("_torque_hf", " hf").replace("_", " ") for column in COLUMNS]
    table(title, ["model", *titles], fidelity_rows(figures, ending=ending))
