"""``motorprior identify``, ``adapt``, ``validate`` and ``validate-log``: motor models on the terminal."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from motorprior.actuator.geared_motor_step import PER_LOGGED
from motorprior.cli.console import TERMINAL, table
from motorprior.commands.adapt import Adapt, run_adapt
from motorprior.commands.identify import Identify
from motorprior.commands.validate import Validate, run_validate
from motorprior.commands.validate_log import ADAPTED, COVERAGE, SPANS, TRAINED_ON, ValidateLog, run_validate_log
from motorprior.identification.adapt import OutlierTest
from motorprior.identification.evaluation.log_tables import (
    FREE_RUN_RMSE,
    WHOLE_RUN_RMSE,
    constant_table,
    constants_in,
    error_table,
)
from motorprior.identification.latents.latent_fit import Posterior
from motorprior.logs.motor_log import MotorLog
from motorprior.report.tables import fidelity_rows
from motorprior.results import Results
from motorprior.studies.metrics import FIDELITY_METRICS

_DISTRIBUTION = (
    "adapt_rmse_ratio", "adapt_false_alarms", "adapt_unlikely", "coverage50", "coverage90", "two_sample_auc",
)  # fmt: skip


@dataclass(frozen=True)
class IdentifyCommand(Identify):
    """Learn a motor prior from the log of a bench, or from logs of a suspended robot."""

    bench: tyro.conf.Positional[tuple[Path, ...]]


@dataclass(frozen=True)
class AdaptCommand(Adapt):
    """Find the motors of a log in the prior's latent space."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


@dataclass(frozen=True)
class ValidateCommand(Validate):
    """Measure how far simulated motors are from the physical ones, in closed loop, on held-out excitation."""

    priors: tyro.conf.Positional[tuple[Path, ...]]


@dataclass(frozen=True)
class ValidateLogCommand(ValidateLog):
    """Measure the errors of a prior's motors and of baselines in free runs on a held-out log."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def adapt(config: AdaptCommand) -> None:
    """See `run_adapt`."""
    run_adapt(config, TERMINAL, _show_adapted)


def _show_adapted(log: MotorLog, found: Posterior, outliers: OutlierTest, constants: dict[str, np.ndarray]) -> None:
    rows = zip(log.joint_names, found.loss, outliers.p_value, outliers.reason, strict=True)
    cells = [[name, f"{loss:.3f}", f"{p_value:.3f}", reason] for name, loss, p_value, reason in rows]
    table("Motors", ["motor", "loss", "p-value", "largest deviation"], cells)
    if constants:
        units = "SI units"
        if any(name.endswith(PER_LOGGED) for name in constants):
            units += f"; …{PER_LOGGED}: per unit of the firmware's gain in the log"
        table(f"Constants of these motors [{units}]", *constant_table(constants))


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
    if figures := results.where(quantity=_DISTRIBUTION).to_figures():
        rows = [[name, f"{value:.3f}"] for name, value in figures.items()]
        table("Preset rollout on held-out motors", ["figure", "value"], rows)


def _show_table(title: str, results: Results, motors: str) -> None:
    columns = tuple(column for column in FIDELITY_METRICS if results.where(quantity=column, motors=motors))
    titles = [column.replace("_rmse", "").replace("_torque_hf", " hf").replace("_", " ") for column in columns]
    table(title, ["model", *titles], fidelity_rows(results, columns, motors))


def validate_log(config: ValidateLogCommand) -> None:
    """See `run_validate_log`."""
    results = run_validate_log(config, TERMINAL)
    trained = results.value(quantity=TRAINED_ON) > 0.0
    warning = " (warning: not a test, the prior was trained on this log)" if trained else ""
    table(f"Free runs, joint RMSE [mrad], over joints{warning}", *error_table(results, SPANS))
    shares = []
    for model in (ADAPTED, "prior"):
        for quantity, span in SPANS.items():
            values = [results.value(quantity=f"{COVERAGE[quantity]}{level}", model=model) for level in (50, 90)]
            shares.append([model, span, *(f"{100 * value:.0f}" for value in values)])
    table(f"Recorded angles inside the bands [%]{warning}", ["model", "free runs", "50 % band", "90 % band"], shares)


def show_real_motors(results: Results, lines: list[str]) -> None:
    """The quick report of `motorprior demo --logs`: errors of the models, constants of the motors, and its lines."""
    spans = {FREE_RUN_RMSE: "1 s", WHOLE_RUN_RMSE: "whole log"}
    titles = {quantity: title for quantity, title in spans.items() if results.where(quantity=quantity)}
    table("Your motors: free runs, joint RMSE [mrad], over joints", *error_table(results, titles))
    if constants := constants_in(results):
        table("Constants of your motors", *constant_table(constants))
    for line in lines:
        print(f"- {line}")
